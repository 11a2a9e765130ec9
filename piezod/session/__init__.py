"""One session of a bench: the control process, its task, its commands and its history."""
