"""What the daemon says, a line at a time, on stderr: a terminal, or the journal."""

import sys


def say(text: str) -> None:
    """One line on stderr, whatever a device or a client put into it."""
    print("".join(c if c.isprintable() else "?" for c in text), file=sys.stderr, flush=True)
