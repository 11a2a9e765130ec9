"""Files of the ticks around a fault. They stay when older recordings are deleted because the folder is full.

    faults/NAME-000001.sqlite, ...

A file begins `recorder.keep_around_s` before the ramp down of the fault. It ends as long after that moment, or when
FAULT is reached if that is later. Together these files take at most `recorder.file_MB`; the oldest is deleted first.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from piezod.recorder.messages import Plan
from piezod.recorder.recording_files import RecordingFile, make_room, recording_files
from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import About
from piezod.recording.ring_log import ROW_DTYPE

FOLDER = "faults"
Stamp = tuple[int, int]  # time of day and clock of the rows, read together [ns]


class FaultFiles:
    """The rows of the last seconds, and the files of the faults in them.

    Parameters
    ----------
    plan
        Settings of the recorder.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan, self._around = plan, plan.rows_around_fault
        self._folder = Path(plan.folder) / FOLDER
        self._rows = np.empty(0, ROW_DTYPE)
        self._first = 0
        self._waiting: list[tuple[int, int]] = []
        self._stamp: Stamp = 0, 0

    def add(self, block: Block, about: About) -> None:
        """Take new rows, and write the file of a fault whose last row has come.

        Parameters
        ----------
        block
            Rows after those of the last call; after a gap the earlier ones are forgotten.
        about
            Description that a file contains.

        Raises
        ------
        OSError, sqlite3.Error
            A file cannot be written; its fault is given up.
        """
        if not self._around:
            return
        if block.first != self._first + self._rows.size:
            self.finish(about)
            self._first = block.first
        seen = max(self._rows.size - 1, 0)
        self._rows = np.concatenate([self._rows, block.rows])
        self._stamp = block.wall_ns, block.clock_ns
        for begin, latched in self._faults(seen):
            self._waiting.append((begin, max(begin + self._around, latched + 1)))
        end = self._first + self._rows.size
        while self._waiting and self._waiting[0][1] <= end:
            self._write(*self._waiting.pop(0), about)
        self._forget()

    def finish(self, about: About) -> None:
        """Write the files of faults with the rows that there are, and forget these.

        Raises
        ------
        OSError, sqlite3.Error
            A file cannot be written.
        """
        waiting, self._waiting = self._waiting, []
        for begin, end in waiting:
            self._write(begin, end, about)
        self._first += self._rows.size
        self._rows = self._rows[:0]

    def _faults(self, seen: int) -> Iterator[tuple[int, int]]:
        """Begin and first row in FAULT of every fault after the row `seen`."""
        in_fault = self._rows["state"] == self._plan.fault
        latched = np.flatnonzero(in_fault[seen + 1 :] & ~in_fault[seen:-1]) + seen + 1
        for row in latched.tolist():
            yield self._ramp_begin(row), self._first + row

    def _forget(self) -> None:
        """Drop the rows that no fault needs any more."""
        first_used = min([self._ramp_begin(self._rows.size), *(fault for fault, _ in self._waiting)])
        dropped = max(0, first_used - self._around - self._first)
        self._rows, self._first = self._rows[dropped:].copy(), self._first + dropped

    def _write(self, begin: int, end: int, about: About) -> None:
        first = max(begin - self._around, self._first)
        rows = self._rows[first - self._first : end - self._first]
        with contextlib.suppress(FileExistsError):
            self._folder.mkdir()
            self._folder.chmod(self._folder.parent.stat().st_mode & 0o7777)
        make_room(recording_files(self._folder, self._plan.bench), self._plan.file_bytes)
        file = RecordingFile(self._folder, self._plan.bench, about)
        try:
            file.commit(Block(rows, first, *self._stamp))
        finally:
            file.close()

    def _ramp_begin(self, row: int) -> int:
        """Number of the first row of a ramp down that ends before an index; without a ramp, of the row at the index."""
        other = np.flatnonzero(self._rows["state"][:row] != self._plan.ramp_down)
        return self._first + (int(other[-1]) + 1 if other.size else 0)
