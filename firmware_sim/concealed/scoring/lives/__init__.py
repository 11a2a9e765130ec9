"""Scores the diagnoses of lives against their sealed truth."""
