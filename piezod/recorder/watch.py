"""The daemon's side of the recorder: starts the recorder process, restarts it after its death, and reports its state.

Runs in the daemon. Nothing here waits for a disk.
"""

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from piezod import __version__
from piezod.config import BenchConfig
from piezod.control import State
from piezod.recorder.messages import Plan, Report, parse_report
from piezod.runtime import chance, clock, processes

RESTART_S = (0.0, 0.5, 1.0, 2.0, 5.0)  # pauses before restarts in a row [s]; the last value repeats
SILENT_S = 3.0  # time without a report after which the disk counts as not answering [s]
START_S = 10.0  # additional time for the first report, on a busy machine [s]
END_WITHIN_S = 10.0  # longest time for the last rows at the end [s]
HEALTHY_S = 60.0  # life of a process after which its restart needs no pause [s]
LONGEST_LINE = 65536


class RecorderWatch:
    """Keeps a recorder process running while the daemon runs.

    Parameters
    ----------
    bench
        Bench configuration with a section `recorder`.
    log
        Called with one line when recording stops or continues.
    metadata
        Additional metadata of the files.
    """

    def __init__(self, bench: BenchConfig, log: Callable[[str], None], metadata: dict[str, str] | None = None) -> None:
        self._plan = _recorder_plan(bench, metadata or {})
        self._period_s = self._plan.sync_every_s
        self._log = log
        self._following: dict[str, str] | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None
        self._report = Report()
        self._rows_before = self._dropped_before = self._failures_before = 0
        self._reported_s = clock.monotonic()
        self._death = ""
        self._logged = ""
        self.restarts = 0

    def follow(self, ring_log: Path) -> None:
        """Record the ring log of a new control process."""
        self._following = {"ring": str(ring_log), "session": chance.token(16)}
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._supervise())
        self._send(self._following)

    @property
    def problem(self) -> str:
        """Reason why ticks are not written to the disk at present; empty while recording works."""
        if self._task is None:
            return ""
        if self._death:
            return self._death
        silent_s = clock.monotonic() - self._reported_s
        if silent_s > SILENT_S + self._period_s:
            return f"{self._plan.folder}: the disk has not answered for {silent_s:.0f} s"
        return self._report.problem

    def log_change(self) -> None:
        """Log once when recording stops, and once when it continues."""
        problem = self.problem
        kind = "" if not problem else problem.rstrip("0123456789 s")  # without the seconds, which increase
        if kind == self._logged:
            return
        if problem:
            self._log(f"recorder degraded: {problem}; control goes on")
        else:
            self._log(f"recorder goes on: {self._report.file or self._plan.folder}, {self.dropped} ticks lost so far")
        self._logged = kind

    @property
    def rows(self) -> int:
        """Number of ticks that were written to the disk."""
        return self._rows_before + self._report.rows

    @property
    def dropped(self) -> int:
        """Number of ticks that were overwritten in the ring log before they were recorded."""
        return self._dropped_before + self._report.dropped

    def as_dict(self) -> dict[str, Any]:
        """State of the recorder, for `piezod status`."""
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
        """Let the recorder write the last rows, for at most `END_WITHIN_S`, and end it."""
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
        self.log_change()

    async def _supervise(self) -> None:
        """Run one recorder process after the other until `close`."""
        attempt = 0
        while self._following is not None:
            begun_s = clock.monotonic()
            await self._run_process()
            if self._following is None:
                break
            attempt = 0 if clock.monotonic() - begun_s > HEALTHY_S else attempt + 1
            self.restarts += 1
            self.log_change()
            await asyncio.sleep(RESTART_S[min(attempt - 1, len(RESTART_S) - 1)] if attempt else 0.0)

    async def _run_process(self) -> None:
        """Start a recorder process and read its reports until it ends."""
        try:
            process = await processes.start_module(
                "piezod.recorder.writer", json.dumps(asdict(self._plan)), LONGEST_LINE
            )
        except OSError as error:
            self._death = f"the recorder does not start: {error.strerror or error}"
            return
        self._process, self._reported_s = process, clock.monotonic() + START_S
        try:
            if self._following is not None:
                self._send(self._following)
            assert process.stdout is not None
            while line := await process.stdout.readline():
                self._report, self._reported_s, self._death = parse_report(line), clock.monotonic(), ""
            code = await process.wait()
        finally:
            self._process = None
            self._keep_sums()
        if self._following is not None:
            self._death = f"the recorder ended with {code}, and is started again"

    def _keep_sums(self) -> None:
        """Add the counts of a process that has ended to the sums."""
        report = self._report
        self._rows_before, self._dropped_before = self.rows, self.dropped
        self._failures_before += report.failures
        report.rows = report.dropped = report.failures = 0

    def _send(self, message: Mapping[str, object]) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError, RuntimeError):
                self._process.stdin.write(json.dumps(message).encode() + b"\n")


def _recorder_plan(bench: BenchConfig, metadata: dict[str, str]) -> Plan:
    """Settings of the recorder process of a bench that has a section `recorder`."""
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
            "model": str(bench.model),
            "limits": bench.limits.summary,
            "drift_file": "" if bench.drift is None else str(bench.drift_path.absolute()),
        }
        | metadata,
        rows_around_fault=round((config.keep_around_s or 0.0) * bench.rate_Hz),
        ramp_down=State.RAMP_DOWN,
        fault=State.FAULT,
        absent=tuple(column for column, role in roles if not bench.has_role(role)),
    )
