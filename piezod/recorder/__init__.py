"""The recorder: a process of its own that keeps every tick on the disk."""
