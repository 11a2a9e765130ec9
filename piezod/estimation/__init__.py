"""Estimation from recordings: the smooth base, the noise, the initial state and the normal equations."""
