"""What a flexible model could still explain."""
