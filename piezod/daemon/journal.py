"""Messages of the daemon on stderr; under systemd they go to the journal."""

import sys


def log_line(text: str) -> None:
    """Write one line to stderr.

    Parameters
    ----------
    text
        Message. Characters that cannot be printed, such as line breaks from a device or a client, become "?".
    """
    print("".join(c if c.isprintable() else "?" for c in text), file=sys.stderr, flush=True)
