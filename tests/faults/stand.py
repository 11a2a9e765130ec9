"""Where faults are injected: benches that are shared among them, and what was seen of each fault."""

import contextlib
import io
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import typer

from piezod.cli import app
from piezod.errors import PiezodError
from tests.faults.live import ROOT, LiveBench


class CannotBeDoneHereError(Exception):
    """This machine does not allow it; the message says what is missing."""


@dataclass
class Seen:
    """What came of a fault.

    Parameters
    ----------
    state
        At the end; empty where there is none.
    exit_code
        Of the command that ended.
    text
        Log lines and messages since the fault.
    after_ms
        From the fault to the first safe state, or to the end of the command; 0 where nothing had to change.
    figures
        What was counted.
    wrong
        What the judge of the output found outside its envelope; None where no output was judged.
    armings
        That nobody asked for.
    """

    state: str = ""
    exit_code: int | None = None
    text: str = ""
    after_ms: float = 0.0
    figures: dict[str, float] = field(default_factory=dict)
    wrong: list[str] | None = None
    armings: int = 0

    def judged(self, fault):
        """What is not as the list expects; empty when the fault was survived."""
        expect, told = fault.expect, self.text.lower()
        bad = []
        if expect.states and expect.states != ("none",) and self.state not in expect.states:
            bad.append(f"state {self.state or 'unknown'}, not {expect.state}")
        if expect.exit_code is not None and self.exit_code != expect.exit_code:
            bad.append(f"exit code {self.exit_code}, not {expect.exit_code}")
        words = (*expect.says, *((fault.logged,) if fault.logged else ()))
        bad += [f"'{word}' was not said" for word in words if word.lower() not in told]
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
        if "traceback (most recent call last)" in told:
            bad.append("a traceback in the log")
        return bad


class Stand:
    """Benches and folders; closed as one."""

    def __init__(self, folder):
        self.folder = folder
        self._benches = {}
        self._count = 0

    def bench(self, wire="tcp", **changes):
        """The shared bench of this wire, healthy and disarmed; with changes of its file one of its own."""
        key = (wire, repr(sorted(changes.items())))
        if key not in self._benches:
            stage = {"wire": wire} if wire == "rtu" else {}
            self._benches[key] = LiveBench(self.new_folder(), stage, changes)
        bench = self._benches[key]
        bench.heal()
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
def standing():
    """A stand in a folder of its own."""
    with served_first(), tempfile.TemporaryDirectory(prefix="piezod-faults-") as name:
        stand = Stand(Path(name))
        try:
            yield stand
        finally:
            stand.drop()


@contextlib.contextmanager
def served_first():
    """Take precedence over what else runs here, where that is allowed: its load is a fault of its own (M3)."""
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


def apart(*arguments, within_s=90.0):
    """A command as a user gives it: exit code, what it printed, how long it took [ms]."""
    begun_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "piezod", *map(str, arguments)],
        capture_output=True, text=True, timeout=within_s, check=False, cwd=ROOT,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr, 1e3 * (time.monotonic() - begun_s)


def command(*arguments):
    """The same in this process, for what starts no other: exit code, what it printed, how long it took [ms]."""
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
