"""The concealed plant: its physics, its drives and its noise."""
