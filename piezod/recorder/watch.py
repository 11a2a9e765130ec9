"""The daemon's end of the recorder: starts its process, starts it again when it dies, and knows what is on the disk."""

import asyncio
import contextlib
import json
import sys
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from piezod import __version__
from piezod.config import BenchConfig
from piezod.control import State
from piezod.recorder.writer import Plan, Report, report_of

RESTART_S = (0.0, 0.5, 1.0, 2.0, 5.0)
SILENT_S = 3.0  # without a report: the disk does not answer
START_S = 10.0  # however busy the machine is
END_WITHIN_S = 10.0
HEALTHY_S = 60.0  # a process that lived so long is started again at once
LONGEST_LINE = 65536


class RecorderWatch:
    """Keeps a recorder going while the daemon runs; nothing here waits for a disk.

    Parameters
    ----------
    bench
        Its `recorder` section says where.
    log
        Called with one line when something changes.
    """

    def __init__(self, bench: BenchConfig, log: Callable[[str], None]) -> None:
        self._plan = plan_of(bench)
        self._period_s = self._plan.sync_every_s
        self._log = log
        self._following: dict[str, str] | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None
        self._report = Report()
        self._rows_before = self._dropped_before = self._failures_before = 0
        self._heard_s = time.monotonic()
        self._died = ""
        self._said = ""
        self.restarts = 0

    def follow(self, ring: Path) -> None:
        """Record a new control process, whose ring log lies there."""
        self._following = {"ring": str(ring), "session": uuid.uuid4().hex}
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._keep_going())
        self._send(self._following)

    @property
    def problem(self) -> str:
        """Why ticks do not come to the disk at the moment; empty when they do."""
        if self._task is None:
            return ""
        if self._died:
            return self._died
        silent_s = time.monotonic() - self._heard_s
        if silent_s > SILENT_S + self._period_s:
            return f"{self._plan.folder}: the disk has not answered for {silent_s:.0f} s"
        return self._report.problem

    def look(self) -> None:
        """Say it when recording stops or goes on."""
        problem = self.problem
        kind = "" if not problem else problem.rstrip("0123456789 s")  # seconds count up
        if kind == self._said:
            return
        if problem:
            self._log(f"recorder degraded: {problem}; control goes on")
        else:
            self._log(f"recorder goes on: {self._report.file or self._plan.folder}, {self.dropped} ticks lost so far")
        self._said = kind

    @property
    def rows(self) -> int:
        """Ticks brought to the disk."""
        return self._rows_before + self._report.rows

    @property
    def dropped(self) -> int:
        """Ticks that the ring log had to overwrite before."""
        return self._dropped_before + self._report.dropped

    def as_dict(self) -> dict[str, Any]:
        """For `status`."""
        report = self._report
        return {
            "degraded": bool(self.problem),
            "problem": self.problem,
            "file": report.file,
            "rows": self.rows,
            "dropped": self.dropped,
            "last_tick": report.tick,
            "bytes": report.bytes,
            "commit_s": report.commit_s,
            "failures": self._failures_before + report.failures,
            "restarts": self.restarts,
            "cpu_s": report.cpu_s,
            "pid": None if self._process is None else self._process.pid,
        }

    async def close(self) -> None:
        """Have everything brought to the disk, within ten seconds."""
        if self._task is None:
            return
        self._send({"end": True})
        self._following = None
        try:
            await asyncio.wait_for(asyncio.shield(self._task), END_WITHIN_S)
        except TimeoutError:
            self._log(f"recorder: the disk did not answer for {END_WITHIN_S:g} s; the last ticks are lost")
        finally:
            if self._process is not None:
                with contextlib.suppress(ProcessLookupError):
                    self._process.kill()
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self.look()

    async def _keep_going(self) -> None:
        """One process after the other, until told to end."""
        attempt = 0
        while self._following is not None:
            begun_s = time.monotonic()
            await self._one_process()
            if self._following is None:
                break
            attempt = 0 if time.monotonic() - begun_s > HEALTHY_S else attempt + 1
            self.restarts += 1
            self.look()
            await asyncio.sleep(RESTART_S[min(attempt - 1, len(RESTART_S) - 1)] if attempt else 0.0)

    async def _one_process(self) -> None:
        try:
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "piezod.recorder.writer",
                json.dumps(asdict(self._plan)),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=LONGEST_LINE,
            )
        except OSError as error:
            self._died = f"the recorder does not start: {error.strerror or error}"
            return
        self._process, self._heard_s = process, time.monotonic() + START_S
        try:
            if self._following is not None:
                self._send(self._following)
            assert process.stdout is not None
            while line := await process.stdout.readline():
                self._hear(report_of(line))
            code = await process.wait()
        finally:
            self._process = None
            self._add_up()
        if self._following is not None:
            self._died = f"the recorder ended with {code}, and is started again"

    def _hear(self, report: Report) -> None:
        self._report, self._heard_s, self._died = report, time.monotonic(), ""

    def _add_up(self) -> None:
        """Keep the sums of a process that has ended."""
        report = self._report
        self._rows_before, self._dropped_before = self.rows, self.dropped
        self._failures_before += report.failures
        report.rows = report.dropped = report.failures = 0

    def _send(self, message: Mapping[str, object]) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError, RuntimeError):
                self._process.stdin.write(json.dumps(message).encode() + b"\n")


def plan_of(bench: BenchConfig) -> Plan:
    """What the recorder of a bench is given."""
    config, folder = bench.recorder, bench.recordings_path
    assert config is not None
    assert folder is not None
    states = ", ".join(f"{state.value} {state.name}" for state in State)
    roles = (("readback_V", "voltage_readback"), ("temperature_C", "temperature"))
    return Plan(
        folder=str(folder.absolute()),
        bench=bench.name,
        sync_every_s=config.sync_every_s,
        file_bytes=1e6 * config.file_MB,
        file_s=3600.0 * config.file_h,
        folder_bytes=1e6 * config.folder_MB,
        metadata={
            "bench": bench.name,
            "rate_Hz": f"{bench.rate_Hz:g}",
            "program": f"piezod {__version__}",
            "states": states,
        },
        absent=tuple(column for column, role in roles if not bench.has_role(role)),
    )
