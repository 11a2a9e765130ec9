"""Messages between the daemon and the recorder process, one JSON object per line.

python -m piezod.recorder.writer PLAN                       a `Plan`

<- {"ring": "/run/piezod/bench.ring", "session": "..."}     on stdin: record this ring log from its first row
<- {"end": true}                                            write the remaining rows, then end
-> {"row": 12000, "tick": 12003, "file": "...", ...}        on stdout: a `Report` of the rows on the disk
"""

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields

from piezod.runtime import clock, descriptors, sockets

_READ_BYTES = 65536


@dataclass(frozen=True)
class Plan:
    """Settings of a recorder process.

    Parameters
    ----------
    bench
        Name of the bench; the prefix of its file names.
    sync_every_s
        Time between two writes to the disk [s].
    file_bytes, file_s
        Size [byte] and age [s] at which a new file begins.
    folder_bytes
        Limit for all files of the bench together [byte].
    absent
        Columns that the device does not have.
    rows_around_fault
        Number of rows before and after the begin of a fault that get a file of their own; 0: none.
    ramp_down, fault
        Values of the column `state` in a ramp down and in a fault.
    """

    folder: str
    bench: str
    sync_every_s: float
    file_bytes: float
    file_s: float
    folder_bytes: float
    metadata: dict[str, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    rows_around_fault: int = 0
    ramp_down: int = -1
    fault: int = -1


@dataclass
class Report:
    """State of a recorder process.

    Parameters
    ----------
    session
        Identifier of the session that is recorded.
    row
        Number of rows of the session that are on the disk or lost.
    tick
        Number of the last tick on the disk; -1 before the first.
    file
        Current or last file.
    rows
        Number of rows that this process has written to the disk.
    dropped
        Number of rows that were overwritten in the ring log before this process read them.
    failures
        Number of files that were abandoned because of an error.
    problem
        Reason of a failure to record; empty while recording works.
    bytes
        Size of all files of the bench [byte].
    commit_s
        Duration of the longest commit since the previous report [s].
    at_s
        Time of the monotonic clock at the end of the last commit [s].
    cpu_s
        Processor time of this process [s].
    """

    session: str = ""
    row: int = 0
    tick: int = -1
    file: str = ""
    rows: int = 0
    dropped: int = 0
    failures: int = 0
    problem: str = ""
    bytes: int = 0
    commit_s: float = 0.0
    at_s: float = 0.0
    cpu_s: float = 0.0


class MessageReader:
    """Reads messages from a file descriptor; used in the recorder process.

    Attributes
    ----------
    closed
        Whether the other process has closed its end.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""
        self.closed = False

    def wait(self, longest_s: float) -> Iterator[dict[str, object]]:
        """Yield the messages that are available now or arrive in time.

        Parameters
        ----------
        longest_s
            Longest time to wait [s].
        """
        if self.closed:
            clock.sleep(longest_s)
            return
        if not sockets.select([self._descriptor], [], [], longest_s)[0]:
            return
        data = descriptors.read(self._descriptor, _READ_BYTES)
        self.closed = not data
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            yield json.loads(line)


def report_sender(descriptor: int) -> Callable[[Report], None]:
    """Make a function that sends reports without waiting; used in the recorder process.

    A report that does not fit into the pipe is discarded: the daemon reads the next one.
    """
    descriptors.set_blocking(descriptor, False)

    def send(report: Report) -> None:
        with contextlib.suppress(OSError):
            descriptors.write(descriptor, json.dumps(asdict(report)).encode() + b"\n")

    return send


def parse_report(line: bytes) -> Report:
    """Make a report from its line; used in the daemon."""
    content = json.loads(line)
    return Report(**{field.name: content[field.name] for field in fields(Report)})
