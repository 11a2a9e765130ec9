"""One drive of a bench: the control process, what it is given, and the commands it takes."""
