"""Starts of a search, from the catalogue and from direct tests of the readings; and unusable readings."""
