"""Benches that the faults share, and the observation of one fault."""

import contextlib
import io
import os
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import typer

from piezod.cli import app
from piezod.errors import PiezodError
from tests.benches.processes import run
from tests.faults.live_bench import DAEMON_ROOT, LiveBench


class InjectionUnavailableError(Exception):
    """This machine does not allow the injection; the message names what is missing."""


@dataclass
class Observation:
    """The observed result of a fault.

    Parameters
    ----------
    state
        Name of the final state; empty without a daemon.
    exit_code
        Exit code of the command that ended; None without one.
    text
        Log lines and messages since the fault.
    after_ms
        Time from the fault to the first safe state, or to the end of the command [ms]; 0 without a change.
    figures
        Counts and measured values by name.
    wrong
        Violations of the output envelope; None where no output was judged.
    armings
        Number of armings without a command.
    """

    state: str = ""
    exit_code: int | None = None
    text: str = ""
    after_ms: float = 0.0
    figures: dict[str, float] = field(default_factory=dict)
    wrong: list[str] | None = None
    armings: int = 0

    def deviations(self, fault):
        """The deviations from the expected result; empty when the fault was survived."""
        expect, text = fault.expect, self.text.lower()
        bad = []
        if expect.states and expect.states != ("none",) and self.state not in expect.states:
            bad.append(f"state {self.state or 'unknown'}, not {expect.state}")
        if expect.exit_code is not None and self.exit_code != expect.exit_code:
            bad.append(f"exit code {self.exit_code}, not {expect.exit_code}")
        words = (*expect.says, *((fault.logged,) if fault.logged else ()))
        bad += [f"'{word}' is in no message" for word in words if word.lower() not in text]
        for name, bound in expect.figures.items():
            if name not in self.figures:
                bad.append(f"{name} was not counted")
            elif not bound.holds(self.figures[name]):
                limit = f"at least {bound.least:g}" if bound.least is not None else ""
                limit += f" at most {bound.most:g}" if bound.most is not None else ""
                bad.append(f"{name} is {self.figures[name]:g}, must be {limit.strip()}")
        if not self.after_ms <= fault.within_ms:
            bad.append(f"after {self.after_ms:.0f} ms, must be within {fault.within}")
        if self.wrong:
            bad.append(f"output outside its envelope: {self.wrong[0]}")
        if self.armings:
            bad.append(f"armed {self.armings} times by itself")
        if "traceback (most recent call last)" in text:
            bad.append("a traceback in the log")
        return bad


USUAL = ("tcp", "[]")  # bench of most faults


class BenchPool:
    """The shared benches, one for each wire and set of changes, and their folders.

    A bench uses a third of a core while nothing is asked of it. So the usual bench stays, and one other at most.
    """

    def __init__(self, folder):
        self.folder = folder
        self._benches = {}
        self._count = 0

    def bench(self, wire="tcp", **changes):
        """The shared bench of this wire and these changes of its file, restored and disarmed."""
        key = (wire, repr(sorted(changes.items())))
        if key not in self._benches:
            for other in [other for other in self._benches if USUAL not in (key, other)]:
                self._benches.pop(other).close()
            device_settings = {"wire": wire} if wire == "rtu" else {}
            self._benches[key] = LiveBench(self.new_folder(), device_settings, changes)
        bench = self._benches[key]
        bench.restore()
        return bench

    def new_folder(self):
        self._count += 1
        folder = self.folder / f"f{self._count}"
        folder.mkdir()
        return folder

    def drop(self):
        """Close the shared benches."""
        benches, self._benches = self._benches, {}
        for bench in benches.values():
            bench.close()


@contextlib.contextmanager
def open_bench_pool():
    """A bench pool in a temporary folder, with raised priority."""
    with raised_priority(), tempfile.TemporaryDirectory(prefix="piezod-faults-") as name:
        pool = BenchPool(Path(name))
        try:
            yield pool
        finally:
            pool.drop()


@contextlib.contextmanager
def raised_priority():
    """Raise the priority of this process where allowed; load of other programs is a separate fault (M3)."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    try:
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    except PermissionError:
        yield
        return
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)


def run_piezod(*arguments, within_s=90.0):
    """Run `piezod` as a process; returns exit code, output and duration [ms]."""
    begun_s = time.monotonic()
    done = run([sys.executable, "-m", "piezod", *map(str, arguments)], timeout=within_s, cwd=DAEMON_ROOT)
    return done.returncode, done.stdout + done.stderr, 1e3 * (time.monotonic() - begun_s)


def run_piezod_in_process(*arguments):
    """Run `piezod` inside this process; returns exit code, output and duration [ms]."""
    out, begun_s = io.StringIO(), time.monotonic()
    code = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            app([str(one) for one in arguments], standalone_mode=False)
        except PiezodError as error:
            print(f"piezod: {error}", file=sys.stderr)
            code = error.exit_code
        except typer.Exit as end:
            code = end.exit_code
        except SystemExit as end:
            code = int(end.code or 0)
    return code, out.getvalue(), 1e3 * (time.monotonic() - begun_s)
