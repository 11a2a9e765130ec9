"""The control process at 1 kHz on the emulated bench: time from deadline to committed state, and memory.

The limit is libmodbus in C doing one exchange a period on the same bench: the same rights, no model, no checks, no log.
"""

import contextlib
import multiprocessing
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from piezod.commissioning.shipped_files import shipped
from piezod.config.reference import WaveformReference
from piezod.control import State
from piezod.daemon.run import drive
from piezod.session.assembly import load_bench_and_model
from piezod.session.history import History
from piezod.session.task import Outcome, SegmentSpec
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.exchange import link_config
from tests.benchmarks.rounds import ROUNDS
from tests.benchmarks.table import NotMeasuredError, Row

DURATION_S = 12.0
PERIOD_US = 1000
MOST_P99_US = 500.0
MOST_RESIDENT_MIB = 250.0
PERCENTILES = (50, 99, 99.9)


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows of completion times, losses and resident memory."""
    duration_s = DURATION_S / 12 if quick else DURATION_S
    with contextlib.ExitStack() as stack:
        with peers.device_priority():
            address = stack.enter_context(peers.emulator("tcp", "real"))
        note, limits_ns = "", []
        try:
            program = stack.enter_context(peers.libmodbus_client())
            count = round(duration_s * 1e6 / PERIOD_US / ROUNDS)
            limits_ns = [peers.libmodbus_ns(program, address, count, PERIOD_US) for _ in range(ROUNDS // 2)]
            history, outcome, resident_MiB = _drive(address, duration_s)
            limits_ns += [peers.libmodbus_ns(program, address, count, PERIOD_US) for _ in range(ROUNDS - ROUNDS // 2)]
        except NotMeasuredError as reason:
            note = f"libmodbus: not measured: {reason}"
            history, outcome, resident_MiB = _drive(address, duration_s)
    yield from _completion(history, limits_ns, note)
    yield from _losses(outcome, history)
    yield from _resident(resident_MiB)


def _drive(address: peers.Address, duration_s: float) -> tuple[History, Outcome, list[float]]:
    """Follow a triangle with the inverse; returns the rows, the outcome, and resident memory [MiB] while it ran."""
    path = shipped("bench.yaml")
    bench, model = load_bench_and_model(path)
    ring_log = f"/dev/shm/piezod-benchmark-{os.getpid()}.ring"
    bench = bench.model_copy(
        update={"link": link_config(address), "daemon": bench.daemon.model_copy(update={"ring_log": ring_log})}
    )
    reference = WaveformReference(
        kind="triangle", amplitude_N=110, offset_N=150, frequency_Hz=0.5, duration_s=duration_s
    )
    resident_MiB: list[float] = []

    def on_rows(rows: np.ndarray) -> None:
        if rows.size and rows["state"][-1] == State.RUNNING:
            resident_MiB.append(_resident_now_MiB())

    segments = [SegmentSpec("triangle", "inverse", reference, reset_cycle=False)]
    history, outcome = drive(path, bench, model, segments, on_rows)
    return history, outcome, resident_MiB


def _resident_now_MiB() -> float:
    (control_process,) = multiprocessing.active_children()
    statm = Path(f"/proc/{control_process.pid}/statm")
    return int(statm.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def _completion(history: History, limits_ns: list[np.ndarray], note: str) -> Iterator[Row]:
    rows = history.rows
    rows = rows[rows["state"] == State.RUNNING]
    rounds_ns = np.array_split(rows["lateness_ns"] + rows["exchange_ns"], ROUNDS)
    for q in PERCENTILES:
        yield Row(
            "whole_tick",
            f"deadline to committed, p{q:g}",
            "us",
            _median_us(rounds_ns, q),
            _median_us(limits_ns, q) if limits_ns else None,
            "libmodbus in C, one exchange a ms",
            most=MOST_P99_US if q == 99 else None,
            note=note,
        )


def _median_us(rounds_ns: list[np.ndarray], q: float) -> float:
    return float(np.median([np.percentile(one, q) for one in rounds_ns])) * 1e-3


def _losses(outcome: Outcome, history: History) -> Iterator[Row]:
    note = "; ".join(text for text in (outcome.fault, *outcome.warnings) if text)
    what = f"of {history.rows.size} ticks"
    yield Row("whole_tick", f"missed {what}", "tick", outcome.missed, note=note)
    yield Row("whole_tick", f"failed exchanges {what}", "tick", outcome.failed_exchanges, note=str(outcome.results))


def _resident(resident_MiB: list[float]) -> Iterator[Row]:
    first, last = resident_MiB[0], resident_MiB[-1]
    yield Row("whole_tick", "resident memory", "MiB", last, most=MOST_RESIDENT_MIB)
    yield Row("whole_tick", "resident memory, against the beginning", "MiB", last, first, "its start", most_ratio=1.001)
