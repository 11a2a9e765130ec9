"""A hypothesis: the forward chain with its effects over all recordings, and its fit."""
