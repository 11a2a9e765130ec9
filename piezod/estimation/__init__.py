"""One estimator: recordings in, a smooth base with the noise, the start and the errors that belong to it."""
