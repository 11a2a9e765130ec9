"""Threads of a process, and waiting for each other."""

import threading

Thread = threading.Thread
"""As `threading.Thread`."""
Condition = threading.Condition
"""As `threading.Condition`."""
