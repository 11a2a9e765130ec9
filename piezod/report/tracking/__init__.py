"""How well a force reference is followed: the errors, the demo and the validation."""
