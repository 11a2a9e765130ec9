"""A ring log filled at a constant rate, a recorder that follows it, and the comparison of its files.

The content of a row follows from its number, so that every written row is known. A row is acknowledged when the
recorder reported it on its pipe.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import numpy as np

from piezod.recorder.messages import Plan, Report, parse_report
from piezod.recording.ring_log import ROW_DTYPE, RingLog
from tests.benches.recorded_blocks import begun_files, read_blocks

WITHIN_S = 120.0  # however busy the machine is
BEGAN_NS = 10**12


def rows_of(first: int, count: int) -> np.ndarray:
    """The rows of these numbers, with values like those of a bench, partly float32."""
    rows = np.zeros(count, ROW_DTYPE)
    k = np.arange(first, first + count)
    rows["tick"], rows["time_ns"] = k, BEGAN_NS + 1_000_000 * k
    rows["reference_N"] = 150.0 + 110.0 * np.sin(1e-3 * k)
    rows["planned_V"] = 70.0 + 50.0 * np.sin(1e-3 * k)
    rows["voltage_V"] = rows["planned_V"].astype(np.float32)
    scatter = (k * 2654435761 % 2**32) / 2**32  # Knuth's multiplicative hash: looks like noise, and is known
    rows["force_N"] = (rows["reference_N"] + scatter).astype(np.float32)
    rows["readback_V"] = (rows["voltage_V"] + 0.01 * scatter).astype(np.float32)
    rows["temperature_C"] = 23.0
    rows["lateness_ns"], rows["exchange_ns"] = 20_000 + 1000 * scatter, 100_000 + 9000 * scatter
    rows["state"] = 2
    return rows


class Feed:
    """Writes rows to the ring log at a constant rate until it is closed.

    Parameters
    ----------
    path
        Path of the ring log.
    rate_Hz
        Rows per second; late rows are written as soon as possible.
    capacity
        Capacity of the ring [rows].
    """

    def __init__(self, path: Path, rate_Hz: float = 1000.0, capacity: int = 60_000) -> None:
        self.path = path
        self.written = 0
        self._ring = RingLog(path, capacity)
        self._rate_Hz = rate_Hz
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        begun_s = time.monotonic()
        while not self._ended.wait(0.005):
            due = int((time.monotonic() - begun_s) * self._rate_Hz)
            for row in rows_of(self.written, due - self.written).tolist():
                self._ring.append(*row)
            self.written = max(self.written, due)

    def close(self) -> int:
        """Stop; returns the number of written rows. Can be called twice."""
        self._ended.set()
        self._thread.join()
        self._ring.close()
        return self.written

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class RecorderProcess:
    """A recorder process, started as the daemon does.

    Parameters
    ----------
    plan
        Plan of the recorder.
    ring
        Path of the ring log.
    prefix
        Command that starts it, such as strace.
    """

    def __init__(self, plan: Plan, ring: Path, *prefix: str) -> None:
        self.last = Report()
        self.worst_commit_s = 0.0
        self.problems: list[str] = []
        self.words: list[tuple[float, int]] = []
        self.process = subprocess.Popen(
            [*prefix, sys.executable, "-m", "piezod.recorder.writer", json.dumps(asdict(plan))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self._send({"ring": str(ring), "session": "study"})
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _send(self, message: dict[str, object]) -> None:
        self.process.stdin.write(json.dumps(message).encode() + b"\n")
        self.process.stdin.flush()

    def _listen(self) -> None:
        for line in self.process.stdout:
            self.last = parse_report(line)
            self.words.append((self.last.at_s, self.last.row))
            self.worst_commit_s = max(self.worst_commit_s, self.last.commit_s)
            if self.last.problem and self.last.problem not in self.problems:
                self.problems.append(self.last.problem)

    def wait_for(self, condition: object) -> None:
        """Wait until the last report meets a condition.

        Raises
        ------
        TimeoutError
            The condition is not met in time.
        """
        deadline_s = time.monotonic() + WITHIN_S
        while not condition(self.last):
            if time.monotonic() > deadline_s or self.process.poll() is not None:
                raise TimeoutError(f"recorder ({self.process.poll()}): {self.last}")
            time.sleep(0.01)

    def acknowledged(self, before_s: float) -> int:
        """Number of rows whose commit ended before this time [s, monotonic]."""
        return max((row for at_s, row in self.words if at_s < before_s), default=0)

    def kill(self) -> Report:
        """Kill it and its prefix command; returns the last acknowledgement."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        return self._ended()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.returncode is None:
            self.kill()

    def end(self) -> Report:
        """Request its end; returns its last report."""
        self._send({"end": True})
        self.process.wait(timeout=WITHIN_S)
        return self._ended()

    def _ended(self) -> Report:
        self.process.wait()
        self._thread.join()
        self.process.stdin.close()
        self.process.stdout.close()
        return self.last


@dataclass
class Comparison:
    """Comparison of the files of a folder with the rows of a feed.

    Parameters
    ----------
    rows
        Number of rows present.
    lost
        Number of acknowledged rows that are missing.
    twice
        Number of rows present more than once.
    wrong
        Number of rows that differ from the written ones, or are out of order.
    damaged
        Number of damaged blocks.
    bytes
        Of the files.
    files
        How many there are.
    """

    rows: int = 0
    lost: int = 0
    twice: int = 0
    wrong: int = 0
    damaged: int = 0
    bytes: int = 0
    files: int = 0

    @property
    def sound(self) -> bool:
        """Whether nothing is lost, twice, wrong or damaged."""
        return not (self.lost or self.twice or self.wrong or self.damaged)


def compare(folder: Path, bench: str, acknowledged: int) -> Comparison:
    """Compare the files of a folder with the written rows."""
    found = Comparison()
    seen: list[np.ndarray] = []
    for path in begun_files(folder, bench) if folder.exists() else ():
        _, blocks, damaged = read_blocks(path)
        found.damaged += damaged
        found.files += 1
        found.bytes += path.stat().st_size
        for block in blocks:
            right = block.rows == rows_of(block.first, block.rows.size)
            found.wrong += int(np.count_nonzero(~right))
            seen.append(block.rows["tick"])
    numbers = np.concatenate(seen) if seen else np.empty(0, np.int64)
    there = np.unique(numbers)
    found.rows = there.size
    found.twice = int(numbers.size - there.size)
    found.wrong += int(np.count_nonzero(np.diff(numbers) < 0))
    found.lost = acknowledged - int(np.count_nonzero(there < acknowledged))
    return found
