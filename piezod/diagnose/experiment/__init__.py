"""Isolability of effects in recordings, and the next experiment."""
