"""What recordings can tell, and the next experiment."""
