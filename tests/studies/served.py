"""The daemon on the emulated bench, with a control process in real time."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from piezod.daemon.client import command_and_wait
from piezod.errors import TemporaryError
from tests.studies.scenarios import ROOT, serving

WITHIN_S = 90.0
PATIENT = {"comm_loss_ms": 2000, "device_watchdog_ms": 1000, "missed_ticks_in_a_row": 200, "stale_after_ms": 20}
EMULATOR_PRIORITY = 60  # below the loop's: what is measured is the loop, not the bench's wait for a core


class Served:
    """A running daemon.

    Parameters
    ----------
    process
        Process of the daemon.
    socket
        Path of the control socket.
    """

    def __init__(self, process: subprocess.Popen, socket: Path) -> None:
        self.process, self._socket = process, socket

    def status(self) -> dict[str, Any]:
        """The status, as of `piezod status --json`."""
        return command_and_wait(self._socket, "status", wait=False)

    def command(self, name: str) -> dict[str, Any]:
        """Send a command and wait for its result."""
        return command_and_wait(self._socket, name, wait=True)

    def wait_until(self, condition: object, within_s: float = WITHIN_S) -> dict[str, Any]:
        """Wait until the status meets a condition; returns the status.

        Raises
        ------
        TimeoutError
            The condition is not met in time.
        """
        deadline_s = time.monotonic() + within_s
        status: dict[str, Any] = {}
        while time.monotonic() < deadline_s:
            with contextlib.suppress(TemporaryError):
                status = self.status()
                if condition(status):
                    return status
            time.sleep(0.05)
        raise TimeoutError(f"the daemon does not reach the expected status: {status}")


@contextlib.contextmanager
def served(folder: Path, recorder: dict[str, object] | None, rate_Hz: float = 1000.0) -> Iterator[Served]:
    """Run a daemon on its own emulated bench; yields it connected and disarmed.

    Parameters
    ----------
    folder
        Folder for its files.
    recorder
        Recorder section of the configuration; None: no recorder.
    rate_Hz
        Rate of the loop [Hz].
    """
    folder.mkdir(parents=True, exist_ok=True)
    emulator = yaml.safe_load((ROOT / "config" / "emulator.yaml").read_text(encoding="utf-8"))
    emulator["tcp"]["port"] = 0
    (folder / "emulator.yaml").write_text(yaml.safe_dump(emulator), encoding="utf-8")
    with serving(folder / "emulator.yaml") as (host, port):
        _hasten_children()
        bench = yaml.safe_load((ROOT / "config" / "bench.yaml").read_text(encoding="utf-8"))
        bench |= {"rate_Hz": rate_Hz, "model": str(ROOT / "config" / "model.yaml"), "recorder": recorder}
        bench["link"] |= {"host": host, "port": port, "timeout_s": 0.5}
        bench["limits"] |= PATIENT
        bench["arming"]["voltage_V_per_s"] = 400.0
        bench["daemon"] = {"ring_log": str(folder / "ring"), "ring_seconds": 30}
        path = folder / "bench.yaml"
        path.write_text(yaml.safe_dump(bench), encoding="utf-8")
        with (folder / "log").open("ab") as log:
            process = subprocess.Popen([sys.executable, "-m", "piezod", "run", str(path)], stderr=log)
        daemon = Served(process, folder / "ring.sock")
        try:
            daemon.wait_until(lambda status: status["connected"] and status["ticks"] > 5)
            yield daemon
        finally:
            process.terminate()
            try:
                process.wait(timeout=WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _hasten_children() -> None:
    """Give the emulator real-time priority where this user may."""
    with contextlib.suppress(OSError):
        for thread in Path("/proc/self/task").iterdir():
            for child in (thread / "children").read_text(encoding="ascii").split():
                if b"firmware_sim" in Path(f"/proc/{child}/cmdline").read_bytes():
                    os.sched_setscheduler(int(child), os.SCHED_FIFO, os.sched_param(EMULATOR_PRIORITY))
