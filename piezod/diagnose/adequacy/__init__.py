"""Adequacy: what a flexible model could still explain."""
