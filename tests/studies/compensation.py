"""Tracking on the emulated bench with plain gain, static inverse and extended inverse, beside the floor.

The bench has the effects in `HIDDEN`, which `piezod` does not know. An identification excitation is recorded over the
link and identified. Mixed work is recorded and diagnosed. Both use `piezod` commands, at the rate of the later run. The
static inverse is that of the identified model, the extended inverse that of the diagnosed model. Every row starts with
a bench after power-on, in virtual time, so that load of the machine has no influence.

Errors are those of the reading, without the first `SETTLES_S` of a run, which contain the approach. The floor is the
noise of the load cell, which no feedforward can reduce. `true` is the error of the true force, which precedes its
reading by the delay of the reading. `limited` is the share of ticks in which the slew limit or a voltage limit of the
bench changed the planned voltage.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from piezod.config.reference import FileReference, WaveformReference
from piezod.errors import PiezodError
from piezod.excitation import IDENTIFICATION
from piezod.model import load_model
from piezod.recording import Recording, write_csv
from tests.studies.driven import Followed, follow, study_bench
from tests.studies.mixed_work import mixed_work
from tests.studies.scenarios import PEAK_V, Size, StepError, recorded_with, run

HIDDEN: dict[str, dict[str, dict[str, object]]] = {
    "creep-lag-delay": {
        "creep": {"per_decade": 0.01},
        "electrical_lag": {"time_constant_s": 0.004},
        "transport_delay": {"delay_s": 0.007},
    },
    "creep": {"creep": {"per_decade": 0.015}},
    "lag-rate": {
        "electrical_lag": {"time_constant_s": 0.004},
        "rate_dependent_hysteresis": {"growth": 0.01, "reference_V_per_s": 10.0},
    },
    "creep-mode": {"creep": {"per_decade": 0.01}, "resonance": {"frequency_Hz": 90.0, "damping_ratio": 0.1}},
}
FIRST = "creep-lag-delay"  # the default bench
AMPLITUDE_N, OFFSET_N = 110.0, 150.0
SMALL_N = 30.0  # at 10 Hz the whole range exceeds the slew limit of the bench at every reversal
SEED, WORK_SEED, RUN_SEED = 1, 3, 5
SETTLES_S = 0.1
PRACTICE_HZ = 1000.0
COMPENSATIONS = {"plain gain": ("gain", "model"), "static inverse": ("inverse", "model")}
EXTENDED = "extended inverse"


@dataclass(frozen=True)
class Extent:
    """Size of the recordings and runs.

    Parameters
    ----------
    identification_Hz
        Frequency of the main triangle of the excitation that the model comes from.
    work_s
        Duration of the mixed work [s].
    orders
        Plays and dead zones; None: chosen on held-out data.
    periods
        Periods of the 0.1 Hz triangle; the durations of the others are proportional.
    """

    identification_Hz: float
    work_s: float
    orders: tuple[int, int] | None
    periods: float


LONG = Extent(0.25, 60.0, None, 3.0)
SHORT = Extent(0.5, 30.0, (14, 6), 1.0)


def references(extent: Extent, folder: Path) -> dict[str, WaveformReference | FileReference]:
    """The references by name; those of `practice` are written into a folder."""
    slow_s = 10.0 * extent.periods
    shapes: dict[str, tuple[str, float, float, float]] = {
        "triangle 0.1 Hz": ("triangle", AMPLITUDE_N, 0.1, slow_s),
        "triangle 1 Hz": ("triangle", AMPLITUDE_N, 1.0, slow_s / 3.0),
        "triangle 10 Hz": ("triangle", AMPLITUDE_N, 10.0, slow_s / 6.0),
        "triangle 10 Hz, small": ("triangle", SMALL_N, 10.0, slow_s / 6.0),
        "multisine 0.25 to 3.25 Hz": ("multisine", AMPLITUDE_N, 0.25, 8.0 if extent.periods > 1.0 else 4.0),
        "staircase 0.05 Hz": ("staircase", AMPLITUDE_N, 0.05, 2.0 * slow_s / 3.0 if extent.periods > 1.0 else 10.0),
    }
    waveforms = {
        name: WaveformReference(
            kind=kind, amplitude_N=amplitude_N, offset_N=OFFSET_N, frequency_Hz=frequency_Hz, duration_s=duration_s
        )
        for name, (kind, amplitude_N, frequency_Hz, duration_s) in shapes.items()
    }
    moves = {}
    for name, force_N in practice().items():
        path = folder / f"{name.replace(' ', '-')}.csv"
        write_csv(Recording(np.arange(force_N.size) / PRACTICE_HZ, {"reference_N": force_N}), path)
        moves[name] = FileReference(kind="file", path=str(path))
    return waveforms | moves


def practice() -> dict[str, NDArray[np.float64]]:
    """Moves as positioning tasks have them, at `PRACTICE_HZ` [N].

    After C. Schindlbeck, C. Pape and E. Reithmeier (2017), Recursive Online Compensation of Piezoelectric
    Nonlinearities via a Modified Prandtl-Ishlinskii Approach, IFAC World Congress, whose trajectories have stationary
    states, varying final times, and small and large ranges in turn. Each move is the polynomial of least jerk between
    two rests.
    """
    levels = (-1.0, 1.0, 0.0, 0.6, -0.4, 0.9, -0.8, 0.2, -1.0)
    small = (-1.0, 1.0, 0.8, 1.0, 0.8, 1.0, -1.0, -0.8, -1.0, -0.8, -1.0, 0.1, -0.1, 0.1, -1.0)
    times_s = (4.0, 2.0, 1.0, 0.5, 0.25, 0.25, 0.5, 1.0)
    return {
        "pauses": _moves(levels, [1.0] * (len(levels) - 1), rest_s=1.5),
        "changing final times": _moves((-1.0, 1.0) * 4 + (-1.0,), times_s, rest_s=0.3),
        "small and large ranges": _moves(small, [0.8] * (len(small) - 1), rest_s=0.2),
    }


def _moves(levels: Sequence[float], times_s: Sequence[float], *, rest_s: float) -> NDArray[np.float64]:
    """Moves of least jerk from level to level of the amplitude, each followed by a rest [N]."""
    parts = [np.full(round(0.5 * PRACTICE_HZ), levels[0])]
    for begin, end, time_s in zip(levels[:-1], levels[1:], times_s, strict=True):
        part = np.linspace(0.0, 1.0, round(time_s * PRACTICE_HZ))
        parts += [begin + (end - begin) * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)]
        parts += [np.full(round(rest_s * PRACTICE_HZ), end)]
    moves: NDArray[np.float64] = OFFSET_N + AMPLITUDE_N * np.concatenate(parts)
    return moves


@dataclass(frozen=True)
class CompensationRow:
    """One reference under one compensation; errors in % of the reference's range.

    Parameters
    ----------
    bench, rate_Hz, reference, compensation
        Bench, rate of the loop [Hz], reference and compensation.
    rms, largest
        Errors of the reading.
    true_rms, true_largest
        Errors of the true force.
    limited
        Share of ticks whose planned voltage a limit changed [%].
    why
        Error message; empty without an error.
    """

    bench: str
    rate_Hz: float
    reference: str
    compensation: str
    rms: float | None = None
    largest: float | None = None
    true_rms: float | None = None
    true_largest: float | None = None
    limited: float | None = None
    why: str = ""

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self)

    def text(self) -> str:
        """One line, and a second one for an error."""
        numbers = (self.rms, self.largest, self.true_rms, self.true_largest)
        line = _COLUMNS.format(
            self.bench,
            f"{self.rate_Hz:g}",
            self.reference,
            self.compensation,
            *("-" if value is None else f"{value:.3f}" for value in numbers),
            "-" if self.limited is None else f"{self.limited:.1f}",
        )
        return f"{line}\n{'':<16}{self.why}" if self.why else line


_COLUMNS = "{:<16} {:>5}  {:<26} {:<17} {:>7} {:>7} {:>9} {:>9} {:>9}"


def header() -> str:
    """The header line."""
    return _COLUMNS.format(
        "bench", "Hz", "reference", "compensation", "rms %", "max %", "true rms", "true max", "limited %"
    )


def summary(rows: Sequence[CompensationRow]) -> str:
    """The summary line: how many rows meet the aims."""
    of: dict[tuple[str, float, str], dict[str, float]] = {}
    for row in rows:
        if row.rms is not None:
            of.setdefault((row.bench, row.rate_Hz, row.reference), {})[row.compensation] = row.rms
    slow = [one for key, one in of.items() if key[2] in SLOW and EXTENDED in one]
    near = [one for one in of.values() if EXTENDED in one and one[EXTENDED] <= NEAR_FLOOR * one["floor"]]
    good = sum(one[EXTENDED] <= AIM_PERCENT for one in slow)
    return (
        f"extended inverse at 0.1 and 1 Hz: {good} of {len(slow)} at most {AIM_PERCENT:g} % rms (static inverse "
        f"{_span([one['static inverse'] for one in slow])} %); at most {NEAR_FLOOR:g} x the floor: {len(near)} of "
        f"{len(of)}. Errors in % of the reference's range: {2 * AMPLITUDE_N:g} N, small {2 * SMALL_N:g} N"
    )


SLOW, AIM_PERCENT, NEAR_FLOOR = ("triangle 0.1 Hz", "triangle 1 Hz"), 0.2, 1.5


def _span(values: Sequence[float]) -> str:
    return f"{min(values):.2f} to {max(values):.2f}" if values else "-"


def study(benches: Sequence[str], rates_Hz: Sequence[float], extent: Extent, folder: Path) -> Iterator[CompensationRow]:
    """Yield the rows: a model for every bench and rate, then every reference with every compensation."""
    for bench in benches:
        for rate_Hz in rates_Hz:
            place = folder / f"{bench}-{rate_Hz:g}"
            try:
                models(place, HIDDEN[bench], rate_Hz, extent)
            except StepError as error:
                yield CompensationRow(bench, rate_Hz, "-", "-", why=str(error))
                continue
            for name, reference in references(extent, place).items():
                yield from driven(bench, rate_Hz, name, reference, place)


def driven(
    bench: str, rate_Hz: float, name: str, reference: WaveformReference | FileReference, place: Path
) -> Iterator[CompensationRow]:
    """Rows of one reference with every compensation, and its floor."""
    scenario = load_scenario("stack", {"effects": HIDDEN[bench]})
    followed: Followed | None = None
    for title, (kind, model) in {**COMPENSATIONS, EXTENDED: ("inverse", "out/model")}.items():
        given = load_model(place / f"{model}.yaml")
        try:
            followed = follow(scenario, RUN_SEED, study_bench(rate_Hz), given, kind, reference)
        except PiezodError as error:
            yield CompensationRow(bench, rate_Hz, name, title, why=str(error))
            continue
        skip = round(SETTLES_S * rate_Hz)
        errors = (*followed.error_percent(followed.reading_N, skip), *followed.error_percent(followed.true_N, skip))
        yield CompensationRow(bench, rate_Hz, name, title, *errors, followed.limited_percent)
    if followed is not None:
        yield CompensationRow(bench, rate_Hz, name, "floor", *floor_percent(followed, bench, rate_Hz))


def floor_percent(followed: Followed, bench: str, rate_Hz: float) -> tuple[float, float]:
    """Difference of the readings with and without noise of the load cell, same voltages [% of the reference range]."""
    noisy = load_scenario("stack", {"effects": HIDDEN[bench]})
    quiet = load_scenario("stack", {"effects": HIDDEN[bench], "load_cell": {"white_noise_N": 0.0}})
    readings = [Bench(one, seed=RUN_SEED).run(followed.voltage_V, 1.0 / rate_Hz) for one in (noisy, quiet)]
    noise = 100.0 * (readings[0] - readings[1]) / followed.range_N
    return float(np.sqrt(np.mean(noise**2))), float(np.abs(noise).max())


def models(place: Path, effects: dict[str, dict[str, object]], rate_Hz: float, extent: Extent) -> dict[str, object]:
    """Record, identify, record work, diagnose: `model.yaml`, `out/model.yaml`; returns the findings.

    Raises
    ------
    StepError
        A command failed.
    """
    findings = place / "out" / "findings.json"
    if not findings.exists():
        size = Size(rate_Hz, extent.work_s, extent.identification_Hz, extent.orders)
        place.mkdir(parents=True, exist_ok=True)
        recorded_with(place / "base", effects, SEED, size, IDENTIFICATION, place / "identification.csv")
        orders = () if extent.orders is None else ("--plays", extent.orders[0], "--dead-zones", extent.orders[1])
        run("identify", place / "identification.csv", "-o", place / "model.yaml", *orders)
        voltage_V = mixed_work(WORK_SEED, extent.work_s, rate_Hz, PEAK_V)
        drive = Recording(np.arange(voltage_V.size) / rate_Hz, {"voltage_V": voltage_V})
        write_csv(drive, place / "drive.csv")
        recorded_with(place / "work", effects, SEED + 1, size, place / "drive.csv", place / "work.csv")
        run("diagnose", place / "work.csv", "--model", place / "model.yaml", "-o", place / "out")
    content: dict[str, object] = json.loads(findings.read_text(encoding="utf-8"))
    return content
