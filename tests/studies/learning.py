"""Iterative learning with each effect of the catalogue hidden: tracking error of every repeat.

The model is that of a bench without any effect. Each effect is switched on, and a looped reference is followed. The
daemon's own learning computes its corrections from the ring log, in virtual time and within one process.

The error is the root mean square of the reading's, over the floor; where the voltage meets its limit, of the other
ticks. The floor is half of what changes from one repeat
to the next without any correction: noise, a tone of its own frequency, an event. The error of the true force is beside
it, since learning trusts the load cell: what is wrong with the reading is learned too, and then the force follows it.
"""

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from firmware_sim.config import Firmware
from firmware_sim.firmware.device import Device
from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from piezod.config import BenchConfig
from piezod.config.reference import FileReference, WaveformReference
from piezod.config.sections import LearningConfig
from piezod.control import RingLog, RingReader, State, TableReference
from piezod.control.references.repeat_correction import RepeatCorrection, correction_cells
from piezod.daemon.learning_watch import LearningWatch
from piezod.model import load_model
from piezod.recording import Recording, write_csv
from piezod.session.assembly import make_loop, make_rate_keeper, make_segment
from piezod.session.task import SegmentSpec
from piezod.transport.modbus import ModbusLink
from tests.contract.judged_bench import FaultyWire, HandClock
from tests.studies.driven import AS_PLANNED_V, Array, study_bench
from tests.studies.scenarios import LONG, ROOT, identified
from tests.studies.strengths import NOISE_N, SWITCHED

REPEATS = 10
SEED = 5
POLL_S = 0.1  # as the daemon reads the ring log
SERVICE_SEED = 41
TRIANGLE = WaveformReference(kind="triangle", amplitude_N=100.0, offset_N=155.0, frequency_Hz=1.0)
BEYOND = WaveformReference(kind="triangle", amplitude_N=150.0, offset_N=155.0, frequency_Hz=1.0)
STEPPED = {"load_step": {"step_N": 5.0, "on_s": 7.0, "off_s": 1e6}}
"""A load that is put on in the middle: the bench is armed for 2 to 3 s before the first repeat."""


@dataclass(frozen=True)
class Case:
    """A hidden effect and the way it is driven.

    Parameters
    ----------
    name
        Name in the table.
    effects
        Effects of the emulated bench.
    reference
        `triangle`, `service` or `beyond`: a triangle that the voltage cannot follow at its ends.
    rate_Hz
        Tick rate [Hz].
    """

    name: str
    effects: dict[str, dict[str, object]]
    reference: str = "triangle"
    rate_Hz: float = LONG.rate_Hz


def _cases() -> dict[str, Case]:
    hidden = {name: {} if name == "none" else {name: one.values} for name, one in SWITCHED.items()}
    cases = [Case(name, effects) for name, effects in hidden.items()]
    cases += [Case(f"{name}:service-loads", effects, "service") for name, effects in hidden.items()]
    for name in ("creep", "friction", "noncongruent_minor_loops", "electrical_lag"):
        cases += [Case(f"{name}:{rate:g}Hz", hidden[name], rate_Hz=rate) for rate in (200.0, 1000.0)]
        cases.append(Case(f"{name}:load-step", hidden[name] | STEPPED))
        cases.append(Case(f"{name}:voltage-limit", hidden[name], "beyond"))
    return {case.name: case for case in cases}


CASES = _cases()


@dataclass(frozen=True)
class LearningRow:
    """Errors of the repeats of one case, root mean square.

    Parameters
    ----------
    case
        Name of the case.
    floor_N
        Floor [N].
    repeats
        Error of the reading in every repeat, over the floor.
    true_N
        Error of the true force in the first and in the last repeat [N].
    plain
        Error of the reading in every repeat without learning, over the floor.
    state
        State of the learning at the end.
    """

    case: str
    floor_N: float
    repeats: tuple[float, ...]
    true_N: tuple[float, float]
    plain: tuple[float, ...]
    state: str

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self)

    def text(self) -> str:
        """One line."""
        repeats = " ".join(f"{one:7.2f}" for one in self.repeats)
        true = f"{self.true_N[0]:7.3f} {self.true_N[1]:7.3f}"
        return f"{self.case:<39} {self.floor_N:7.3f} {repeats}  {self.plain[-1]:8.2f}  {true}  {self.state}"

    @property
    def is_worse(self) -> bool:
        """Whether the corrected repeats are worse than the same ones without learning, by more than noise."""
        learned, plain = (np.sqrt(np.mean(np.square(one[2:]))) for one in (self.repeats, self.plain))
        return bool(learned > 1.1 * max(plain, 1.0))


def header() -> str:
    """The header line."""
    repeats = " ".join(f"{one:>7}" for one in range(1, REPEATS + 1))
    return f"{'hidden':<39} {'floor N':>7} {repeats}  {f'plain {REPEATS}':>8}  {'true N':>7} {'last':>7}"


def summary(rows: Sequence[LearningRow]) -> str:
    """The summary line."""
    fifth = sorted(row.repeats[4] for row in rows)
    met = sum(one <= 1.1 for one in fifth)
    worse = [row.case for row in rows if row.is_worse]
    stopped = [row.case for row in rows if row.state == "stopped"]
    return (
        f"fifth repeat: at most 1.1 floors in {met} of {len(rows)}, median {np.median(fifth):.2f}; worse than "
        f"without learning: {', '.join(worse) or 'none'}; stopped: {', '.join(stopped) or 'none'}"
    )


def study(names: Sequence[str], folder: Path, *, jobs: int) -> Iterator[LearningRow]:
    """Rows in the order of the names."""
    model = identified(folder, LONG)
    write_csv(_service_loads(), folder / "service.csv")
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(_row, names, [model] * len(names), [folder] * len(names))


def _service_loads() -> Recording:
    """Four seconds of random loads that begin and end alike: sums of sines from 0.25 to 6 Hz, seldom near the ends."""
    random = np.random.default_rng(SERVICE_SEED)
    time_s = np.arange(4001) / 1000.0
    force_N = np.zeros(time_s.size)
    for harmonic in range(1, 25):
        phase = random.uniform(0.0, 2.0 * np.pi)
        force_N += harmonic**-0.7 * np.sin(2.0 * np.pi * 0.25 * harmonic * time_s + phase)
    return Recording(time_s, {"reference_N": 155.0 + 100.0 * force_N / np.abs(force_N).max()})


def _row(name: str, model: Path, folder: Path) -> LearningRow:
    case = CASES[name]
    reference = {"triangle": TRIANGLE, "beyond": BEYOND}.get(case.reference) or FileReference(
        kind="file", path=str(folder / "service.csv"), loop=True, closing_row="drop"
    )
    bench = study_bench(case.rate_Hz).model_copy(
        update={"model": str(model), "learning": LearningConfig(), "reference": reference}
    )
    read, true, limited, state = _drive(case, bench, model, learns=True)
    plain, _, _, _ = _drive(case, bench, model, learns=False)
    if case.reference == "beyond":
        within = ~limited.any(axis=0)
        read, true, plain = read[:, within], true[:, within], plain[:, within]
    floor_N = float(np.sqrt(np.median([np.mean((b - a) ** 2) / 2.0 for a, b in pairwise(plain)])))
    learned, without = (tuple(_rms(one) / floor_N for one in errors) for errors in (read, plain))
    return LearningRow(name, floor_N, learned, (_rms(true[0]), _rms(true[-1])), without, state)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _drive(case: Case, bench: BenchConfig, model_file: Path, *, learns: bool) -> tuple[Array, Array, Array, str]:
    """Errors of the reading and of the true force [N], limited ticks, a row a repeat; the state of the learning."""
    scenario = load_scenario("stack", {"load_cell": {"white_noise_N": NOISE_N}, "effects": case.effects})
    physics, model = Bench(scenario, seed=SEED), load_model(model_file)
    device = Device(physics, Firmware(), "virtual", lambda: 0)
    link = ModbusLink(bench.link, FaultyWire(device, HandClock(0), timeout_ms=0))
    with tempfile.TemporaryDirectory() as folder:
        daemon = bench.daemon.model_copy(update={"ring_log": f"{folder}/ring"})
        bench = bench.model_copy(update={"daemon": daemon})
        clock = make_rate_keeper(bench, link)
        segment = make_segment(SegmentSpec("study", "inverse"), bench, model, link, ROOT)
        assert isinstance(segment.reference, TableReference)
        ticks = len(segment.reference)
        watch = None
        if learns:
            cells = np.zeros(correction_cells(ticks))
            segment.reference.correct_by(RepeatCorrection(cells))
            shared = RepeatCorrection(cells)
            watch = LearningWatch(bench, ROOT / "bench.yaml", model, shared, _ignored, run=lambda work: work())
        ring = RingLog(bench.ring_log_path, REPEATS * ticks + round(60 * bench.rate_Hz))
        polled, reader = RingReader(bench.ring_log_path), RingReader(bench.ring_log_path)
        loop = make_loop(bench, link, clock, ring)
        link.poll()
        loop.arm(segment)
        true_N, followed = [], 0
        while followed < REPEATS * ticks + 1:
            loop.run_tick()
            loop.wait()
            true_N.append(physics.true_force_N)
            followed += loop.supervisor.state is State.RUNNING
            assert loop.supervisor.state in (State.ARMING, State.RUNNING), loop.supervisor.fault.name
            if watch is not None and len(true_N) % round(POLL_S * bench.rate_Hz) == 0:
                watch.add(polled.read())
        ring.close()
        rows = reader.read()
    running = rows["state"] == State.RUNNING
    commands = np.flatnonzero(running[:-1] & running[1:])[: REPEATS * ticks]
    reference_N = rows["reference_N"][commands]
    errors = (rows["force_N"][commands + 1] - reference_N, np.array(true_N)[commands + 1] - reference_N)
    limited = np.abs(rows["planned_V"] - rows["voltage_V"])[commands] > AS_PLANNED_V
    read, true, limited = (one.reshape(REPEATS, ticks) for one in (*errors, limited))
    return read, true, limited, "" if watch is None else str(watch.as_dict()["state"])


def _ignored(line: str) -> None:
    """Log nothing."""
