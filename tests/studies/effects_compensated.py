"""Each effect of the catalogue alone on the emulated bench: tracking error before and after compensation.

A model is identified on a bench without any effect. The effect is switched on, mixed work is recorded and diagnosed,
and a reference is followed with the inverse of either model, in virtual time. The tracking error is that of the force
on the load cell, in % of the range of the reference. For a transport delay it is that of the reading, since a reading
does not show on which side of the force a delay is. An effect in the load cell must not change the voltage. For it the
table shows the error of the reading, raw and corrected (`piezod.model.expected`).
"""

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from firmware_sim.physics.scenario import load_scenario
from piezod.config.reference import WaveformReference
from piezod.effects import EFFECTS
from piezod.errors import PiezodError
from piezod.model import Model, acting_effects, load_model
from piezod.model.expected import ExpectedReading
from piezod.recording import Recording, write_csv
from tests.studies.driven import Array, Followed, follow, study_bench
from tests.studies.mixed_work import mixed_work
from tests.studies.scenarios import (
    PEAK_V,
    WORK_NOISE,
    WORK_SEED,
    Size,
    StepError,
    identified,
    logged,
    recorded,
    run,
)
from tests.studies.strengths import NOISE_N, SWITCHED, Switched

RUN_SEED = 5
SETTLES_S = 0.1
USUAL = WaveformReference(kind="multisine", amplitude_N=100.0, offset_N=155.0, frequency_Hz=0.5, duration_s=20.0)
FAST = WaveformReference(kind="triangle", amplitude_N=100.0, offset_N=155.0, frequency_Hz=6.0, duration_s=5.0)
REFERENCES = {"slew_limit": FAST, "rate_dependent_hysteresis": FAST}
GOES_ON = ("gain_drift",)  # grows with the on-time: driven after the duration of the recording
READ_LATE = ("transport_delay",)


@dataclass(frozen=True)
class EffectRow:
    """Result of one effect; errors are root mean squares in % of the range of the reference.

    Parameters
    ----------
    effect
        The active effect.
    handling
        Handling in the catalogue.
    named
        Effects that the diagnosis names.
    before, after
        Tracking error with the inverse of the identified and of the diagnosed model.
    read, corrected
        Error of the reading against the true force, raw and corrected.
    refused
        Reason for which the effect is not compensated; `after` is then without it.
    why
        Error message; empty without an error.
    """

    effect: str
    handling: str = ""
    named: tuple[str, ...] = ()
    before: float | None = None
    after: float | None = None
    read: float | None = None
    corrected: float | None = None
    refused: str = ""
    why: str = ""

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self)

    def text(self) -> str:
        """One line, and a second one for a refusal or an error."""
        line = _COLUMNS.format(
            self.effect,
            self.handling,
            *(_number(one) for one in (self.before, self.after, self.read, self.corrected)),
            ", ".join(self.named) or "-",
        ).rstrip()
        note = self.refused or self.why
        return f"{line}\n{'':<27}{note}" if note else line


_COLUMNS = "{:<26} {:<25} {:>8} {:>8} {:>8} {:>9}  {}"


def header() -> str:
    """The header line."""
    return _COLUMNS.format("effect", "handling", "before %", "after %", "read %", "corrected", "named")


def summary(rows: Sequence[EffectRow]) -> str:
    """The summary line."""
    done = [row for row in rows if row.before is not None and row.after is not None]
    better = [row.effect for row in done if row.handling == "compensated" and row.after < 0.5 * row.before]
    shown = [row.effect for row in done if row.corrected is not None and row.corrected < 0.5 * row.read]
    return (
        f"tracking error at least halved: {', '.join(better) or '-'}; error of the reading at least halved: "
        f"{', '.join(shown) or '-'}; refused: {', '.join(row.effect for row in rows if row.refused) or '-'}; "
        f"the noise is {100 * NOISE_N / (2 * USUAL.amplitude_N):.3f} %"
    )


def study(names: Sequence[str], size: Size, folder: Path, *, jobs: int) -> Iterator[EffectRow]:
    """Rows in the order of the names."""
    model = identified(folder, size)
    work = folder / "drive.csv"
    voltage_V = mixed_work(WORK_SEED, size.work_s, size.rate_Hz, PEAK_V)
    write_csv(Recording(np.arange(voltage_V.size) / size.rate_Hz, {"voltage_V": voltage_V}), work)
    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(lambda name: judged(name, SWITCHED[name], model, work, size, folder), names)


def judged(name: str, switched: Switched, model: Path, work: Path, size: Size, folder: Path) -> EffectRow:
    """Record the work with what is switched on, diagnose it, drive with both models."""
    place = folder / name
    try:
        if not (place / "out" / "findings.json").exists():
            record = recorded if switched.over_link else logged
            record(place, switched, WORK_NOISE, size, work, place / "work.csv")
            threads = {"OMP_NUM_THREADS": "1"}
            run("diagnose", place / "work.csv", "--model", model, "-o", place / "out", threads=threads)
        findings = json.loads((place / "out" / "findings.json").read_text(encoding="utf-8"))
        named = tuple(one["name"] for one in findings["effects"])
        return driven(name, switched, named, load_model(model), load_model(place / "out" / "model.yaml"), size)
    except (StepError, PiezodError) as error:
        return EffectRow(name, EFFECTS[name].handling, why=str(error))


def driven(
    name: str, switched: Switched, named: tuple[str, ...], static: Model, extended: Model, size: Size
) -> EffectRow:
    """One reference with either model on the bench with the effect."""
    scenario = load_scenario("stack", {"load_cell": {"white_noise_N": NOISE_N}, "effects": {name: switched.values}})
    bench, reference = study_bench(size.rate_Hz), REFERENCES.get(name, USUAL)
    on_for_s = size.work_s if name in GOES_ON else 0.0
    refused = [one for one in acting_effects(extended) if EFFECTS[one].handling == "refused"]
    without = bench.model_copy(update={"compensation_without": tuple(refused)})
    before = follow(scenario, RUN_SEED, bench, static, "inverse", reference, on_for_s)
    after = follow(scenario, RUN_SEED, without, extended, "inverse", reference, on_for_s)
    skip = round(SETTLES_S * size.rate_Hz)

    def error(followed: Followed) -> float:
        return followed.error_percent(followed.reading_N if name in READ_LATE else followed.true_N, skip)[0]

    of_reading = EFFECTS[name].handling == "corrected in the reading"
    corrected = corrected_N(after, extended, size)
    return EffectRow(
        name,
        EFFECTS[name].handling,
        named,
        error(before),
        error(after),
        _rms_percent(after.reading_N - after.true_N, after, skip) if of_reading else None,
        _rms_percent(corrected - after.true_N, after, skip) if of_reading else None,
        f"refused: {EFFECTS[name].why}" if EFFECTS[name].handling == "refused" else "",
    )


def corrected_N(followed: Followed, model: Model, size: Size) -> Array:
    """The force behind the readings, from rest on, as `piezod run` shows it."""
    voltage_V = np.concatenate((followed.before_V, followed.voltage_V))
    reading_N = np.concatenate((followed.before_N, followed.reading_N))
    _, corrected = ExpectedReading(model, 1.0 / size.rate_Hz).run(voltage_V, reading_N)
    return corrected[followed.before_V.size :]


def _rms_percent(error_N: Array, followed: Followed, skip: int) -> float:
    return 100.0 * float(np.sqrt(np.mean(error_N[skip:] ** 2))) / followed.range_N


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
