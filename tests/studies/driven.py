"""A force reference followed on the emulated bench, in virtual time and within one process.

Loop, limits, link and frames are those of the daemon; device and physics are `firmware_sim`, without a socket between
them. So the true force on the load cell is available beside its reading, and a run is reproducible to the bit.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_sim.config import Firmware
from firmware_sim.firmware.device import Device
from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import Scenario
from piezod.config import BenchConfig, load_bench
from piezod.config.reference import FileReference, WaveformReference
from piezod.control import RingLog, RingReader, State, TableReference
from piezod.model import Model
from piezod.session.assembly import make_loop, make_rate_keeper, make_segment
from piezod.session.task import SegmentSpec
from piezod.transport.modbus import ModbusLink
from tests.contract.judged_bench import FaultyWire, HandClock
from tests.studies.scenarios import LIMITS, ROOT

Array = NDArray[np.float64]

AS_PLANNED_V = 1e-3  # tolerance for float32 on the wire


@dataclass(frozen=True)
class Followed:
    """Signals of a run along a reference, one value for each tick, each shape (N,).

    Parameters
    ----------
    reference_N
        Reference at the end of the tick [N].
    reading_N
        Reading of the load cell at the end of the tick [N].
    true_N
        True force on the load cell at the end of the tick [N].
    planned_V, voltage_V
        Planned voltage of the compensation, and written voltage [V].
    before_V, before_N
        Voltages and readings from rest to the first tick, each shape (M,) [V], [N].
    """

    reference_N: Array
    reading_N: Array
    true_N: Array
    planned_V: Array
    voltage_V: Array
    before_V: Array
    before_N: Array

    @property
    def range_N(self) -> float:
        """Range of the reference [N]."""
        return float(np.ptp(self.reference_N))

    @property
    def limited_percent(self) -> float:
        """Share of ticks in which a limit changed the planned voltage [%]."""
        return 100.0 * float(np.mean(np.abs(self.planned_V - self.voltage_V) > AS_PLANNED_V))

    def error_percent(self, force_N: Array, skip: int = 0) -> tuple[float, float]:
        """Root mean square and largest error of a force [% of the reference's range], without the first ticks."""
        error = 100.0 * (force_N - self.reference_N)[skip:] / self.range_N
        return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


def study_bench(rate_Hz: float) -> BenchConfig:
    """The shipped bench with the limits of a study, at a rate; without an opened link."""
    bench = load_bench(ROOT / "config" / "bench.yaml")
    link = bench.link.model_copy(update={"heartbeat_within_s": 1e3})
    arming = bench.arming.model_copy(update={"without": ("sign_check",)})
    limits = bench.limits.model_copy(update=LIMITS | {"tracking_trip_N": None, "stale_after_ms": 1e3})
    return bench.model_copy(update={"rate_Hz": rate_Hz, "link": link, "limits": limits, "arming": arming})


def follow(
    scenario: Scenario,
    seed: int,
    bench: BenchConfig,
    model: Model,
    compensation: str,
    reference: WaveformReference | FileReference,
    on_for_s: float = 0.0,
) -> Followed:
    """Arm a bench after its power-on, follow a reference to its end, ramp down.

    Parameters
    ----------
    scenario, seed
        The emulated bench.
    bench
        Rate and limits.
    model, compensation
        Model, and its compensation: `gain` or `inverse`.
    reference
        Reference that ends.
    on_for_s
        Time at rest from power-on to arming [s].

    Raises
    ------
    AssertionError
        A fault ended the run early.
    """
    physics = Bench(scenario, seed=seed)
    physics.advance(on_for_s)
    device = Device(physics, Firmware(), "virtual", lambda: 0)
    link = ModbusLink(bench.link, FaultyWire(device, HandClock(0), timeout_ms=0))
    clock = make_rate_keeper(bench, link)
    segment = make_segment(SegmentSpec("study", compensation, reference), bench, model, link, ROOT)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ring"
        assert isinstance(segment.reference, TableReference)
        ring = RingLog(path, len(segment.reference) + round(60.0 * bench.rate_Hz))
        reader = RingReader(path)
        loop = make_loop(bench, link, clock, ring)
        link.poll()
        loop.arm(segment)
        true_N = []
        while loop.supervisor.driving:
            loop.run_tick()
            true_N.append(physics.true_force_N)
            loop.wait()
        ring.close()
        rows = reader.read()
    assert not loop.supervisor.fault, loop.supervisor.fault.name
    assert rows.size == len(true_N)
    return _paired(rows, np.array(true_N))


def _paired(rows: NDArray[np.void], true_N: Array) -> Followed:
    """Pair each command with the reading of the next exchange, which shows its force."""
    running = rows["state"] == State.RUNNING
    commands = np.flatnonzero(running[:-1] & running[1:])
    answers = commands + 1
    first = int(commands[0])
    return Followed(
        rows["reference_N"][commands],
        rows["force_N"][answers],
        true_N[answers],
        rows["planned_V"][commands],
        rows["voltage_V"][commands],
        rows["voltage_V"][:first],
        rows["force_N"][1 : first + 1],
    )
