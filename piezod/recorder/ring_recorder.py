"""Moves the rows of the ring log to files on the disk; runs in the recorder process.

The ring log is the queue between the control loop and the disk. It contains the last `daemon.ring_seconds`, the loop
never waits for it, and overwritten rows are counted. Disk, file or folder may fail at any time: the rows then stay in
the ring log, and are written to a new file as soon as possible.
"""

import contextlib
import sqlite3
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.errors import PiezodError
from piezod.recorder.fault_files import FaultFiles
from piezod.recorder.messages import Plan, Report
from piezod.recorder.recording_files import (
    RecordingFile,
    make_room,
    recording_files,
    size_bytes,
    sync,
    tidy_files,
)
from piezod.recording.formats.sqlite import read_end
from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import About
from piezod.recording.ring_log import ROW_DTYPE, RingReader
from piezod.runtime import clock

MAX_BLOCK_ROWS = 16_384  # largest number of rows of one block; a backlog after a slow disk is written in several blocks
FOLDER_MODE = 0o750
RETRY_S = (0.0, 0.5, 1.0, 2.0, 5.0)  # pauses after failed writes in a row [s]; the last value repeats


class RingRecorder:
    """Writes one ring log after the other to files.

    Attributes
    ----------
    report
        State, updated by every method.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._folder = Path(plan.folder)
        self._reader: RingReader | None = None
        self._dropped_before = 0
        self._positioned = False
        self._origin_ns: int | None = None
        self._file: RecordingFile | None = None
        self._begun_s = 0.0
        self._other_bytes = 0
        self._faults = FaultFiles(plan)
        self._failed_in_a_row = 0
        self._retry_at_s = 0.0
        self.report = Report()

    def follow(self, ring_log: Path, session: str) -> None:
        """Write the rest of the previous ring log, then change to another one.

        Parameters
        ----------
        session
            Identifier of the session that writes it.
        """
        self.finish()
        self._dropped_before = self.report.dropped
        self._reader, self._positioned, self._origin_ns = None, False, None
        self.report.session, self.report.row, self.report.tick = session, 0, -1
        try:
            self._reader = RingReader(ring_log)
        except PiezodError as error:
            self.report.problem = str(error)

    def step(self) -> None:
        """Write the new rows to the disk; after a failure report the reason and retry later."""
        reader = self._reader
        if reader is None or clock.monotonic() < self._retry_at_s:
            return
        first = None
        if reader.waiting:
            self.report.commit_s = 0.0
        try:
            self._seek_start(reader)
            while (rows := reader.read(MAX_BLOCK_ROWS)).size:
                first = reader.next - rows.size
                block = self._write(rows, first)
                self._failed_in_a_row, self.report.problem = 0, ""
                self._keep_faults(block)
        except (OSError, sqlite3.Error) as error:
            if first is not None:
                reader.seek(first)
            self._fail(error)
        self.report.dropped = self._dropped_before + reader.dropped
        self.report.cpu_s = round(clock.process_time(), 3)

    def finish(self) -> None:
        """Write the remaining rows and close the file; rows that cannot be written now count as dropped."""
        self._retry_at_s = 0.0
        self.step()
        self._close()
        self._keep_faults(None)
        if self._reader is not None:
            self.report.dropped += self._reader.waiting
            self._reader = None

    def _seek_start(self, reader: RingReader) -> None:
        """Continue after the last row that a previous recorder process wrote for this session.

        The files are read only once. After a failed sync they may show rows that are not on the disk.
        """
        if self._positioned:
            return
        self._make_folder()
        tidy_files(recording_files(self._folder, self._plan.bench))
        about, row = _end_of(recording_files(self._folder, self._plan.bench))
        if about is not None and about.session == self.report.session:
            reader.seek(row)
            self._origin_ns, self.report.row = about.origin_ns, row
        self._positioned = True

    def _write(self, rows: NDArray[np.void], first: int) -> Block:
        if self._origin_ns is None:
            self._origin_ns = int(rows["time_ns"][0])
        block = Block(rows, first, clock.wall_ns(), clock.boot_ns())
        if self._file is None:
            self._file = self._begin_file()
        begun_s = clock.monotonic()
        self._file.commit(block)
        report = self.report
        report.at_s = clock.monotonic()
        report.commit_s = max(report.commit_s, round(report.at_s - begun_s, 6))
        report.row, report.tick = first + rows.size, int(rows["tick"][-1])
        report.rows += rows.size
        size = self._file.bytes
        report.bytes = self._other_bytes + size_bytes(self._file.path)
        if size >= self._plan.file_bytes or clock.monotonic() - self._begun_s >= self._plan.file_s:
            self._close()
        return block

    def _keep_faults(self, block: Block | None) -> None:
        """Files of the faults in a block, or of all that still wait; a failure is only reported."""
        try:
            if block is None:
                self._faults.finish(self._about(kept="around a fault"))
            else:
                self._faults.add(block, self._about(kept="around a fault"))
        except (OSError, sqlite3.Error) as error:
            self.report.problem = f"{self._folder}: no file of the ticks around a fault: {_reason(error)}"

    def _about(self, **metadata: str) -> About:
        plan, origin_ns = self._plan, self._origin_ns or 0
        return About(ROW_DTYPE, "ticks", plan.metadata | metadata, self.report.session, origin_ns, tuple(plan.absent))

    def _begin_file(self) -> RecordingFile:
        """Remove old files until a new one fits, then begin it."""
        plan = self._plan
        self._make_folder()
        existing = recording_files(self._folder, plan.bench)
        tidy_files(existing)
        self._other_bytes = make_room(existing, plan.folder_bytes - plan.file_bytes)
        began = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(clock.wall_s()))
        file = RecordingFile(self._folder, plan.bench, self._about(began=began))
        self._begun_s = clock.monotonic()
        self.report.file = str(file.path)
        return file

    def _make_folder(self) -> None:
        with contextlib.suppress(FileExistsError):
            self._folder.mkdir()
            self._folder.chmod(FOLDER_MODE)

    def _fail(self, error: OSError | sqlite3.Error) -> None:
        """Abandon the file: after a failed write the content of the disk is unknown. Committed rows stay."""
        place = self._folder if self._file is None else self._file.path
        self._close()
        pause_s = RETRY_S[min(self._failed_in_a_row, len(RETRY_S) - 1)]
        self._failed_in_a_row += 1
        self._retry_at_s = clock.monotonic() + pause_s
        self.report.failures += 1
        self.report.problem = f"{place}: {_reason(error)}"

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def _end_of(paths: list[Path]) -> tuple[About | None, int]:
    """Description of the newest readable file, and the number of the row after its last one.

    Raises
    ------
    OSError
        The file cannot be synchronised: a recorder that was killed may not have done it.
    """
    for path in reversed(paths):
        sync(path)
        with contextlib.suppress(OSError, sqlite3.Error, PiezodError):
            return read_end(path)
    return None, 0


def _reason(error: OSError | sqlite3.Error) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    name = getattr(error, "sqlite_errorname", "")
    return f"{error} ({name})" if name else str(error)
