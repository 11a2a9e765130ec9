"""The figures of a diagnosis page."""
