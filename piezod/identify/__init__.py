"""From recordings to a model that can be inverted, and the figures that say how good it is."""
