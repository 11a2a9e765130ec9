"""From recordings to an invertible model with its figures of merit."""
