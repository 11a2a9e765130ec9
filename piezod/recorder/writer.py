"""The recorder: a process of its own that follows the ring log and keeps every tick on the disk.

    python -m piezod.recorder.writer PLAN      a `Plan` as JSON

    <- {"ring": "/run/piezod/bench.ring", "session": "..."}     on stdin: follow this ring from its beginning
    <- {"end": true}                                            keep what is there, and end
    -> {"row": 12000, "tick": 12003, "file": "...", ...}        on stdout: what is on the disk, a `Report`

The ring log is the queue between the loop and the disk: it holds `daemon.ring_seconds`, never makes the loop wait, and
what it has to overwrite is counted. Disk, file or folder may fail at any time: ticks then stay in the ring, and are
written to a new file as soon as that is possible. When whoever started it dies, it goes on until no more ticks come.
"""

import contextlib
import json
import os
import select
import signal
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.errors import PiezodError
from piezod.recorder.segment_files import Segment, make_room, segments, settle, size_of, sync
from piezod.recording.formats.sqlite import read_end
from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import About
from piezod.recording.ring_log import ROW_DTYPE, RingReader

MOST_ROWS = 16_384  # of one block: what is caught up after a slow disk
RETRY_S = (0.0, 0.5, 1.0, 2.0, 5.0)
QUIET_S = 2.0  # without a tick: the control process, orphaned, has ended
ORPHAN_WITHIN_S = 60.0
_READ = 65536


@dataclass(frozen=True)
class Plan:
    """What a recorder is given.

    Parameters
    ----------
    folder, bench
        Where files are written, and the bench they are named for.
    sync_every_s
        How often the ring is looked at and everything brought to the disk [s].
    file_bytes, file_s
        Size and age at which a new file is begun.
    folder_bytes
        What all files of the bench may take.
    metadata
        Written into every file.
    absent
        Columns that the device does not have.
    """

    folder: str
    bench: str
    sync_every_s: float
    file_bytes: float
    file_s: float
    folder_bytes: float
    metadata: dict[str, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()


@dataclass
class Report:
    """What became of the ticks so far.

    Parameters
    ----------
    session
        That is followed.
    row, tick
        Of the session: the number of rows that are on the disk or lost, and the last tick on the disk; -1 before it.
    file, file_rows
        That is written, or was last, and how many rows it holds.
    rows, dropped
        That this process brought to the disk, and that the ring had to overwrite before.
    failures
        Files that were given up because of an error.
    problem
        Why nothing is recorded at the moment; empty when all is well.
    bytes
        What the files of this bench take.
    commit_s, at_s
        How long the longest commit since the report before took, and when the last one was over on the monotonic
        clock [s].
    cpu_s
        Processor time of this process [s].
    """

    session: str = ""
    row: int = 0
    tick: int = -1
    file: str = ""
    file_rows: int = 0
    rows: int = 0
    dropped: int = 0
    failures: int = 0
    problem: str = ""
    bytes: int = 0
    commit_s: float = 0.0
    at_s: float = 0.0
    cpu_s: float = 0.0


class Recorder:
    """Follows one ring log after the other and writes segments.

    Parameters
    ----------
    plan
        Where and how much.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._folder = Path(plan.folder)
        self._ring: RingReader | None = None
        self._dropped_before = 0
        self._placed = False
        self._origin_ns: int | None = None
        self._segment: Segment | None = None
        self._begun_s = 0.0
        self._other_bytes = 0
        self._failed_in_a_row = 0
        self._retry_at_s = 0.0
        self.report = Report()

    def follow(self, ring: Path, session: str) -> None:
        """Keep what is left of the ring before, and go on with this one."""
        self.finish()
        self._dropped_before = self.report.dropped
        self._ring, self._placed, self._origin_ns = None, False, None
        self.report.session, self.report.row, self.report.tick = session, 0, -1
        try:
            self._ring = RingReader(ring)
        except PiezodError as error:
            self.report.problem = str(error)

    def step(self) -> None:
        """Bring to the disk what is new; where that fails, note why and try again later."""
        ring = self._ring
        if ring is None or time.monotonic() < self._retry_at_s:
            return
        first = None
        if ring.waiting:
            self.report.commit_s = 0.0
        try:
            self._place(ring)
            while (rows := ring.read(MOST_ROWS)).size:
                first = ring.next - rows.size
                self._keep(rows, first)
                self._failed_in_a_row, self.report.problem = 0, ""
        except (OSError, sqlite3.Error) as error:
            if first is not None:
                ring.seek(first)
            self._fail(error)
        self.report.dropped = self._dropped_before + ring.dropped
        self.report.cpu_s = round(time.process_time(), 3)

    def finish(self) -> None:
        """Keep what is there, and close the file; what cannot be kept now is lost."""
        self._retry_at_s = 0.0
        self.step()
        self._close()
        if self._ring is not None:
            self.report.dropped += self._ring.waiting
            self._ring = None

    def _place(self, ring: RingReader) -> None:
        """Go on after what a recorder before has kept of this session.

        Files are asked once only: after a sync that failed they show what the disk does not hold.
        """
        if self._placed:
            return
        self._make_folder()
        settle(segments(self._folder, self._plan.bench))
        about, row = _end_of(segments(self._folder, self._plan.bench))
        if about is not None and about.session == self.report.session:
            ring.seek(row)
            self._origin_ns, self.report.row = about.origin_ns, row
        self._placed = True

    def _keep(self, rows: NDArray[np.void], first: int) -> None:
        if self._origin_ns is None:
            self._origin_ns = int(rows["time_ns"][0])
        block = Block(rows, first, time.time_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME))
        if self._segment is None:
            self._segment = self._begin()
        begun_s = time.monotonic()
        self._segment.commit(block)
        report = self.report
        report.at_s = time.monotonic()
        report.commit_s = max(report.commit_s, round(report.at_s - begun_s, 6))
        report.row, report.tick = first + rows.size, int(rows["tick"][-1])
        report.rows += rows.size
        report.file_rows += rows.size
        size = self._segment.bytes
        report.bytes = self._other_bytes + size_of(self._segment.path)
        if size >= self._plan.file_bytes or time.monotonic() - self._begun_s >= self._plan.file_s:
            self._close()

    def _begin(self) -> Segment:
        """Make room for a file, then begin it."""
        plan = self._plan
        self._make_folder()
        existing = segments(self._folder, plan.bench)
        settle(existing)
        self._other_bytes = make_room(existing, plan.folder_bytes - plan.file_bytes)
        began = {"began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
        about = About(
            ROW_DTYPE, "ticks", plan.metadata | began, self.report.session, self._origin_ns or 0, tuple(plan.absent)
        )
        segment = Segment(self._folder, plan.bench, about)
        self._begun_s = time.monotonic()
        self.report.file, self.report.file_rows = str(segment.path), 0
        return segment

    def _make_folder(self) -> None:
        with contextlib.suppress(FileExistsError):
            self._folder.mkdir()

    def _fail(self, error: OSError | sqlite3.Error) -> None:
        """Give the file up: after a failed write nobody knows what the disk has of it; what is committed stays."""
        place = self._folder if self._segment is None else self._segment.path
        self._close()
        pause_s = RETRY_S[min(self._failed_in_a_row, len(RETRY_S) - 1)]
        self._failed_in_a_row += 1
        self._retry_at_s = time.monotonic() + pause_s
        self.report.failures += 1
        self.report.problem = f"{place}: {_reason(error)}"

    def _close(self) -> None:
        if self._segment is not None:
            self._segment.close()
            self._segment = None


def _end_of(paths: list[Path]) -> tuple[About | None, int]:
    """The newest file that can be read: what it says about itself, and the row after its last one.

    Raises
    ------
    OSError
        What was read may not be on the disk: a recorder that was killed may not have come to its sync.
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


class Inbox:
    """Lines on a descriptor, one JSON object each.

    Parameters
    ----------
    descriptor
        Is read without waiting longer than asked.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""
        self.closed = False

    def wait(self, longest_s: float) -> Iterator[dict[str, object]]:
        """Messages that are there now, or come within this time [s]."""
        if self.closed:
            time.sleep(longest_s)
            return
        if not select.select([self._descriptor], [], [], longest_s)[0]:
            return
        data = os.read(self._descriptor, _READ)
        self.closed = not data
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            yield json.loads(line)


def run(recorder: Recorder, inbox: Inbox, tell: Callable[[Report], None], look_every_s: float) -> None:
    """Record until told to end, or until, after the other end has gone, no more ticks come."""
    ending = False

    def end(*_: object) -> None:
        nonlocal ending
        ending = True

    signal.signal(signal.SIGTERM, end)
    orphaned_s = quiet_s = float("inf")
    row = -1
    while not ending:
        for message in inbox.wait(look_every_s):
            if "ring" in message:
                recorder.follow(Path(str(message["ring"])), str(message["session"]))
            ending = ending or bool(message.get("end"))
        recorder.step()
        tell(recorder.report)
        now_s = time.monotonic()
        if not inbox.closed or recorder.report.row != row:
            row, quiet_s = recorder.report.row, now_s
        orphaned_s = min(orphaned_s, now_s) if inbox.closed else orphaned_s
        gone_quiet = now_s - quiet_s > max(QUIET_S, 2 * look_every_s)
        ending = ending or (inbox.closed and (gone_quiet or now_s - orphaned_s > ORPHAN_WITHIN_S))
    recorder.finish()
    tell(recorder.report)


def tell_on(descriptor: int) -> Callable[[Report], None]:
    """Write reports as lines; one that nobody takes in time is left out."""
    os.set_blocking(descriptor, False)

    def tell(report: Report) -> None:
        with contextlib.suppress(OSError):
            os.write(descriptor, json.dumps(asdict(report)).encode() + b"\n")

    return tell


def report_of(line: bytes) -> Report:
    """A report from the line that says it."""
    said = json.loads(line)
    return Report(**{one.name: said[one.name] for one in fields(Report)})


def main() -> None:
    """Enter the recorder's process."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    plan = Plan(**json.loads(sys.argv[1]))
    run(Recorder(plan), Inbox(sys.stdin.fileno()), tell_on(sys.stdout.fileno()), plan.sync_every_s)


if __name__ == "__main__":
    main()
