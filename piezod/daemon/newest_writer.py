"""Writes files in a thread of its own, so that a disk that stands delays nobody but the file."""

from collections.abc import Callable

from piezod.runtime import threads


class NewestWriter:
    """Writes the newest content of each of a few files, one after the other.

    A content that waits while a newer one for the same file comes is dropped.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, Callable[[], None]] = {}
        self._changed = threads.Condition()
        self._is_writing = False

    def write(self, name: str, job: Callable[[], None]) -> None:
        """Write a file soon, without waiting for it.

        Parameters
        ----------
        name
            Name of the file.
        job
            Writes its content, and notes its own errors.
        """
        with self._changed:
            self._waiting[name] = job
            if not self._is_writing:
                self._is_writing = True
                threads.Thread(target=self._write_all, daemon=True).start()

    def flush(self, within_s: float) -> bool:
        """Wait until all is written; False if that takes longer than `within_s` [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._is_writing, within_s)

    def _write_all(self) -> None:
        while True:
            with self._changed:
                if not self._waiting:
                    self._is_writing = False
                    self._changed.notify_all()
                    return
                job = self._waiting.pop(next(iter(self._waiting)))
            try:
                job()
            except BaseException:
                with self._changed:
                    self._is_writing = False
                raise
