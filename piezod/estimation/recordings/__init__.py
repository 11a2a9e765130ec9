"""From files to samples that can be fitted: intake, suitability, stuck readings, noise, and the initial state."""
