"""Tools to commission a bench: init, check, record, validate, demo, safe stop, support bundle."""
