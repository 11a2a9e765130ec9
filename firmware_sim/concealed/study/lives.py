"""The life of a concealed bench: five recordings, with one change of the bench between the third and the fourth.

No hidden effect acts in the identification (step 0). The hidden effects act in the work of step 1, and step 2 repeats
it unchanged. One thing has changed in step 3, and step 4 repeats that. A held-out record belongs to no step.

The change is one of `CHANGES`. A draw whose change shows by less than `LEAST_SHOWN` noises is repeated.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.plant.drives import Drive, mixed_work, temperature
from firmware_sim.concealed.plant.hysteresis import draw_hysteresis
from firmware_sim.concealed.plant.record_context import Effect
from firmware_sim.concealed.study.case import Case, Record
from firmware_sim.concealed.study.catalogue import ENTRIES, ONCE
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.entry import COME_SINCE
from firmware_sim.concealed.study.strength import VisibleDifference

CHANGES = ("grows", "shrinks", "gone", "new", "gain", "specimen", "none")
LASTING = tuple(name for name in ENTRIES if name not in ONCE | {"gain_drift", "clock_skew", "quantisation"})
"""Effects that a bench keeps from one recording to the next. A drift begins anew in every recording of this plant."""

FACTOR = 2.0  # by which a parameter grows or shrinks
GAINS = (0.93, 0.98)  # range of the remaining gain of an aged stack [1]
LEAST_SHOWN = 3.0  # of a change [noise rms]
WORK_S = 40.0
STEPS = 5
ATTEMPTS = 40


@dataclass(frozen=True)
class Step:
    """One recording of a life.

    Parameters
    ----------
    case
        Plant and effects while it was made.
    """

    case: Case
    record: Record


@dataclass(frozen=True)
class Life:
    """Five recordings of a bench.

    Parameters
    ----------
    family
        One of `families.FAMILIES`.
    change
        One of `CHANGES`.
    effect
        Effect that changes, goes or comes; empty for the other changes.
    steps
        Its recordings in order.
    held_out
        Record on which every model of the life is compared.
    """

    family: str
    change: str
    effect: str
    steps: tuple[Step, ...]
    held_out: Record

    @property
    def hidden(self) -> dict[str, Effect]:
        """Effects of the first recording of work, by name."""
        return dict(self.steps[1].case.effects)

    @property
    def since(self) -> dict[str, Effect]:
        """Effects after the change, by name."""
        return dict(self.steps[-1].case.effects)


def draw_life(family: str, change: str, seed: np.random.SeedSequence) -> Life:
    """Draw a life.

    Parameters
    ----------
    family
        One of `families.FAMILIES`.
    change
        One of `CHANGES`.

    Raises
    ------
    StudyError
        No attempt gave a change that shows.
    """
    for child in seed.spawn(ATTEMPTS):
        life = _attempt(family, change, child)
        if life is not None:
            return life
    raise StudyError(f"{family}, {change}: no change showed in {ATTEMPTS} attempts; take another --seed")


def _attempt(family: str, change: str, seed: np.random.SeedSequence) -> Life | None:
    own, of_case = seed.spawn(2)
    rng = np.random.Generator(np.random.PCG64(own))
    count = 2 if change in {"new", "gone"} else int(rng.integers(1, 3))
    names = tuple(str(name) for name in rng.choice(LASTING, count, replace=False))
    spec = CaseSpec("pair" if count == 2 else "single", names, (20.0, 4.0)[:count], "white", family)
    try:
        case = draw_case(spec, of_case)
    except StudyError:
        return None
    everything = {name: replace(on, scope=COME_SINCE) for name, on in case.effects.items()}
    effect = names[-1] if change in {"grows", "shrinks", "gone", "new"} else ""
    before = {name: on for name, on in everything.items() if change != "new" or name != effect}
    changed = _changed(case, before, everything, change, effect, rng)
    if changed is None:
        return None
    first = replace(case, effects=before)
    cases = (first, first, first, changed, changed)
    records = (case.records[0], *(work_record(case, number, rng) for number in range(1, STEPS)))
    steps = tuple(Step(state, record) for state, record in zip(cases, records, strict=True))
    if change != "none" and _shown(first, changed, records[3]) < LEAST_SHOWN:
        return None
    held_out = replace(work_record(case, STEPS, rng), name="held_out.csv")
    return Life(family, change, effect, steps, held_out)


def _changed(
    case: Case,
    before: Mapping[str, Effect],
    everything: Mapping[str, Effect],
    change: str,
    effect: str,
    rng: np.random.Generator,
) -> Case | None:
    """The bench after its change; None: the parameter would leave its plausible range."""
    after, plant = dict(before), case.plant
    if change == "gone":
        del after[effect]
    elif change == "new":
        after = dict(everything)
    elif change == "gain":
        law = replace(plant.law, full_N=plant.law.full_N * rng.uniform(*GAINS))
        plant = Plant(plant.hysteresis, plant.noncongruent, law)
    elif change == "specimen":
        kind, reach_V = plant.hysteresis.kind, plant.hysteresis.reach_V
        plant = Plant(draw_hysteresis(rng, kind, reach_V), plant.noncongruent, plant.law)
    elif change in {"grows", "shrinks"}:
        scale, on = ENTRIES[effect].scale, after[effect]
        factor = FACTOR if change == "grows" else 1.0 / FACTOR
        if scale.startswith(":"):
            return None
        after[effect] = replace(on, parameters=on.parameters | {scale: factor * on.parameters[scale]})
        if not ENTRIES[effect].plausible(after[effect]):
            return None
    return replace(case, plant=plant, effects=after)


def work_record(case: Case, number: int, rng: np.random.Generator, duration_s: float = WORK_S) -> Record:
    """Mixed work from rest; as fast as the bench's first work.

    Parameters
    ----------
    case
        Bench, with a record of work.
    number
        Number in the name of the file.
    duration_s
        Duration [s].
    """
    model = next(record for record in case.records if record.name.startswith("recording")).drive
    rate_Hz, reach_V = model.rate_Hz, float(model.voltage_V.max())
    most_V_per_s = float(np.abs(np.diff(model.voltage_V)).max()) * rate_Hz
    voltage_V = np.round(mixed_work(rng, reach_V, rate_Hz, duration_s, most_V_per_s), 4)
    warmth = temperature(rng, duration_s + 1.0, rate_Hz)[: voltage_V.size]
    drive: Drive = replace(model, voltage_V=voltage_V, temperature_C=warmth)
    return Record(f"work_{number}.csv", drive, int(rng.integers(2**40)))


def _shown(before: Case, after: Case, record: Record) -> float:
    """Rms of the change over a recording, after gain and offset unless the gain itself changed [noise rms]."""
    first = _without_noise(before, record)
    second = _without_noise(after, record)
    if before.plant.law is not after.plant.law:
        return float(np.std(second - first)) / before.noise.rms_N
    visible = VisibleDifference(first, record.drive.voltage_V, record.drive.rate_Hz)
    return visible.after_gain_and_offset_N(second) / before.noise.rms_N


def _without_noise(case: Case, record: Record) -> Array:
    return case.plant.reading_N(record.drive, case.active(record), record.seed)
