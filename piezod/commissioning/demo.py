"""The demo: the whole path on the emulated bench, with plain gain and with the inverse, on two references."""

import contextlib
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.commissioning.emulator import emulated_bench
from piezod.commissioning.shipped_files import shipped
from piezod.config import BenchConfig
from piezod.config.reference import WaveformReference
from piezod.recording import Recording
from piezod.session.assembly import Work, load
from piezod.session.history import History
from piezod.session.session import Outcome, Session

REFERENCES = {
    "triangle": WaveformReference(kind="triangle", amplitude_N=110, offset_N=150, frequency_Hz=0.5, duration_s=4.0),
    "multisine": WaveformReference(kind="multisine", amplitude_N=110, offset_N=150, frequency_Hz=0.25, duration_s=4.0),
}
STALL_S = 0.5  # a virtual machine may stand still for a tenth of a second; the demo must not call that a lost device
COMPENSATIONS = ("gain", "inverse")

OnRows = Callable[[NDArray[np.void]], None]


@dataclass(frozen=True)
class DemoResult:
    """What the demo measured."""

    recordings: dict[tuple[str, str], Recording]
    history: History
    outcome: Outcome


def run_demo(on_rows: OnRows, work_names: list[str]) -> DemoResult:
    """Start the emulator, follow every reference with every compensation, stop.

    Parameters
    ----------
    on_rows
        Called about ten times a second with what is new; for a live line.
    work_names
        Filled with the names of the stretches of work, in their order.

    Raises
    ------
    PiezodError
        The bench did not come up, or the session failed.
    """
    works = [
        Work(f"{reference}, {compensation}", compensation, REFERENCES[reference])
        for reference in REFERENCES
        for compensation in COMPENSATIONS
    ]
    work_names.extend(work.name for work in works)
    with _demo_bench() as (bench, path):
        _, model = load(path)
        session = Session(bench, model, path.parent, works)
        history = follow_session(session, on_rows)
    keys = [(reference, compensation) for reference in REFERENCES for compensation in COMPENSATIONS]
    recordings = {}
    for number, key in enumerate(keys):
        metadata = {"bench": bench.name, "reference": key[0], "compensation": key[1]}
        recordings[key] = history.recording(number, metadata=metadata)
    return DemoResult(recordings, history, session.outcome)


def follow_session(session: Session, on_rows: OnRows) -> History:
    """Start a session and keep every row until it ends; Ctrl-C asks for a ramp down, and is followed to its end."""
    history = History()
    before = signal.signal(signal.SIGINT, lambda *_: session.stop())
    try:
        session.start()
        for rows in session.follow():
            history.add(rows)
            on_rows(rows)
    finally:
        session.close()
        signal.signal(signal.SIGINT, before)
    return history


@contextlib.contextmanager
def _demo_bench() -> Iterator[tuple[BenchConfig, Path]]:
    path = shipped("bench.yaml")
    bench, _ = load(path)
    with emulated_bench(shipped("emulator.yaml"), "--port", "0") as serves:
        host, _, port = serves["tcp"].rpartition(":")
        link = bench.link.model_copy(update={"host": host, "port": int(port), "timeout_s": STALL_S})
        patience = {
            "comm_loss_ms": 2000 * STALL_S,
            "device_watchdog_ms": round(1000 * STALL_S),
            "missed_ticks_in_a_row": round(STALL_S * bench.rate_Hz),
        }
        limits = bench.limits.model_copy(update=patience)
        ring_log = f"/dev/shm/piezod-demo-{port}.ring"  # noqa: S108  # shared memory is meant to be seen
        daemon = bench.daemon.model_copy(update={"ring_log": ring_log})
        yield bench.model_copy(update={"link": link, "limits": limits, "daemon": daemon}), path
