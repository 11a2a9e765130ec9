"""File formats of recordings, one file a format."""
