"""Messages of the daemon on stderr; under systemd they go to the journal.

A thread writes them from a bounded queue. A reader of stderr that stands still or has gone therefore neither delays
nor ends the daemon: what cannot be written is dropped and counted.
"""

import sys
from collections import deque
from datetime import UTC, datetime

from piezod.runtime import clock, descriptors, threads

MOST_WAITING = 1000  # lines that wait to be written; further ones are dropped
MOST_RECENT = 1000  # lines that are kept for a support bundle
FLUSH_WITHIN_S = 1.0  # longest time that the end of the program waits for the last lines [s]


class Journal:
    """Writes lines to a file descriptor, in a thread of its own.

    Parameters
    ----------
    descriptor
        Open for writing; None: that of stderr at the time of the write.

    Attributes
    ----------
    dropped
        Number of lines that were not written.
    recent
        Last `MOST_RECENT` lines with their time of day, also those that were dropped.
    is_quiet
        Whether lines are only added to `recent`: a command that drives prints its own result.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        self._descriptor = descriptor
        self._lines: deque[str] = deque()
        self._changed = threads.Condition()
        self._thread: threads.Thread | None = None
        self.dropped = 0
        self.is_quiet = False
        self.recent: deque[str] = deque(maxlen=MOST_RECENT)

    def add(self, text: str) -> None:
        """Add one line; it is dropped if `MOST_WAITING` lines wait."""
        self.recent.append(f"{datetime.fromtimestamp(clock.wall_s(), UTC).isoformat(timespec='milliseconds')} {text}")
        if self.is_quiet:
            return
        with self._changed:
            if self._thread is None:
                self._thread = threads.Thread(target=self._write_all, name="journal", daemon=True)
                self._thread.start()
            if len(self._lines) >= MOST_WAITING:
                self.dropped += 1
                return
            self._lines.append(text)
            self._changed.notify_all()

    def flush(self, within_s: float = FLUSH_WITHIN_S) -> bool:
        """Wait until all lines are written or dropped; False if that takes longer than `within_s` [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._lines, within_s)

    def _write_all(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._lines)
                text = self._lines[0]  # stays in the queue while it is being written, so that `flush` waits for it
            written = self._written(text)
            with self._changed:
                self._lines.popleft()
                self.dropped += not written
                self._changed.notify_all()

    def _written(self, text: str) -> bool:
        rest = f"{text}\n".encode("utf-8", "replace")
        try:
            descriptor = sys.stderr.fileno() if self._descriptor is None else self._descriptor
            while rest:
                rest = rest[descriptors.write(descriptor, rest) :]
        except (OSError, ValueError, AttributeError):  # the reader has gone; stderr is closed or replaced
            return False
        return True


JOURNAL = Journal()  # messages of this process


def log_line(text: str) -> None:
    """Write one line to stderr without waiting for it.

    Parameters
    ----------
    text
        Message. Characters that cannot be printed, such as line breaks from a device or a client, become "?".
    """
    JOURNAL.add("".join(c if c.isprintable() else "?" for c in text))
