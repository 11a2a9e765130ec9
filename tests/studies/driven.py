"""A force reference followed on the emulated bench, in virtual time and within one process.

Loop, limits, link and frames are the daemon's, device and physics are `firmware_sim`; only the socket between them is
left out. So the true force on the load cell can be noted beside its reading, and a run repeats to the bit.
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
from piezod.config.reference import WaveformReference
from piezod.control import RingLog, RingReader, State
from piezod.model import Model
from piezod.session.assembly import make_loop, make_rate_keeper, make_segment
from piezod.session.task import SegmentSpec
from piezod.transport.modbus import ModbusLink
from tests.contract.judged_bench import FaultyWire, HandClock
from tests.studies.scenarios import LIMITS, ROOT

Array = NDArray[np.float64]

AS_PLANNED_V = 1e-3  # float32 on the wire


@dataclass(frozen=True)
class Followed:
    """What became of a reference while it was followed, one value a tick, each shape (N,).

    Parameters
    ----------
    reference_N
        Wanted at the end of the tick [N].
    reading_N
        Of the load cell at the end of the tick [N].
    true_N
        On the load cell at the end of the tick [N].
    planned_V, voltage_V
        What the compensation wished, and what was written [V].
    before_V, before_N
        Voltages and readings from rest until then, each shape (M,) [V], [N].
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
        """Of the reference [N]."""
        return float(np.ptp(self.reference_N))

    @property
    def limited_percent(self) -> float:
        """Ticks in which a limit changed what was planned [%]."""
        return 100.0 * float(np.mean(np.abs(self.planned_V - self.voltage_V) > AS_PLANNED_V))

    def error_percent(self, force_N: Array, skip: int = 0) -> tuple[float, float]:
        """Root mean square and largest error of a force [% of the reference's range], without the first ticks."""
        error = 100.0 * (force_N - self.reference_N)[skip:] / self.range_N
        return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


def study_bench(rate_Hz: float) -> BenchConfig:
    """The shipped bench with the limits of a study, at a rate; its link is not opened."""
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
    reference: WaveformReference,
    on_for_s: float = 0.0,
) -> Followed:
    """Arm a bench that has just been switched on, follow a reference to its end, ramp down.

    Parameters
    ----------
    scenario, seed
        The emulated bench.
    bench
        Rate and limits.
    model, compensation
        `gain` or `inverse` of the model.
    reference
        With a duration.
    on_for_s
        How long the bench was on, at rest, before it is armed [s].

    Raises
    ------
    AssertionError
        A fault ended it early.
    """
    physics = Bench(scenario, seed=seed)
    physics.advance(on_for_s)
    device = Device(physics, Firmware(), "virtual", lambda: 0)
    link = ModbusLink(bench.link, FaultyWire(device, HandClock(0), timeout_ms=0))
    clock = make_rate_keeper(bench, link)
    segment = make_segment(SegmentSpec("study", compensation, reference), bench, model, link, ROOT)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ring"
        ring = RingLog(path, round((reference.duration_s + 60.0) * bench.rate_Hz))
        reader = RingReader(path)
        loop = make_loop(bench, link, clock, ring)
        link.poll()
        loop.arm(segment)
        true_N = []
        while loop.supervisor.driving:
            loop.run_tick()
            true_N.append(physics.true_force_N)
            clock.wait()
        ring.close()
        rows = reader.read()
    assert not loop.supervisor.fault, loop.supervisor.fault.name
    assert rows.size == len(true_N)
    return _paired(rows, np.array(true_N))


def _paired(rows: NDArray[np.void], true_N: Array) -> Followed:
    """An exchange reads the force that the command before it has led to, so readings move one row up."""
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
