"""One case judged: what was named right, what wrong, and how well.

Definitions
-----------
exact set
    The names given are the names of the catalogue's effects that are in the case: none missing, none too many.
alarm (on a null)
    Any name, or a verdict that says that something is there (`explained`, `partly_explained`, `unexplained`).
covered
    A true effect that is among the names given, or among the rivals of any of them.
flagged (on a foreign case)
    The verdict is `unexplained` or `partly_explained`.
sure name (on a foreign case)
    The verdict is `explained`, or a wrong name was given with a confidence of at least 0.9 whatever the verdict.
place found
    A place of the effect's own finding, or else of the whole mismatch, on the same axis: two spans of time overlap by
    at least half of their union, or both their ends agree within 0.1 s; a line's or a mode's frequency agrees within 2
    %; the rate or voltage above which an effect acts (`low`) within 10 %. A place that names another recording does not
    count.
parameter error
    |found - true| / |true| of an effect that was named rightly; a wrong sign is thus an error above 100 %.
gap closed
    (e0^2 - e1^2) / (e0^2 - floor^2) on the held-out record, with e0 of the model without effects and e1 of the extended
    one. Both are taken against the noise-free force without tones, one-off events and converter steps, whose floor is
    0: in expectation that is the same as against the measurement with the noise's rms for a floor, without its scatter.
    Not counted where e0 is below half the noise's rms (nothing to close on this record), or where every effect of the
    case is one that another record does not repeat. A missing or infinite simulation closes nothing: 0.
"""

import math
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.scoring.verdicts import Named, Verdict
from firmware_sim.concealed.study.catalogue import UNREPEATABLE
from firmware_sim.concealed.study.truth import Place, TrueCase, TrueEffect

SURE = 0.9
OVERLAP, EDGES_S = 0.5, 0.1
LINE, THRESHOLD = 0.02, 0.10
LEAST_GAP = 0.5  # of the noise's rms
UNSCORED = frozenset({"from_s", "to_s", "reference_V_per_s", "on_s", "off_s"})
"""Parameters without an error: spans that reach beyond the records, a reference that only goes with its growth; and
times, which are places."""


@dataclass(frozen=True)
class ParameterError:
    """How far a parameter was off, relative to its true value (1)."""

    effect: str
    parameter: str
    error: float


@dataclass(frozen=True)
class PlaceJudged:
    """A true place, and whether it was found."""

    effect: str
    place: Place
    found: bool


@dataclass(frozen=True)
class Judgement:
    """One case judged; the module's docstring defines the terms.

    Parameters
    ----------
    case, verdict
        What is there, and what was said.
    covered
        True effects among the names or their rivals.
    places, errors
        Of the true effects.
    gap_closed
        None: not counted.
    """

    case: TrueCase
    verdict: Verdict
    covered: frozenset[str]
    places: tuple[PlaceJudged, ...]
    errors: tuple[ParameterError, ...]
    gap_closed: float | None

    @property
    def exact(self) -> bool:
        """Whether the exact set was named."""
        return self.verdict.names == self.case.names

    @property
    def alarm(self) -> bool:
        """Whether anything was said to be there."""
        return bool(self.verdict.names) or self.verdict.verdict not in {"matches", "not_testable"}

    @property
    def sure_name(self) -> bool:
        """Whether a foreign effect was given a sure name."""
        wrong = [named for named in self.verdict.effects if named.name not in self.case.names]
        return self.verdict.verdict == "explained" or any(named.confidence >= SURE for named in wrong)

    @property
    def names_right(self) -> tuple[tuple[float, bool], ...]:
        """Confidence of each name given, and whether it is true."""
        return tuple((named.confidence, named.name in self.case.names) for named in self.verdict.effects)


def judge(case: TrueCase, verdict: Verdict, held_out: "HeldOut | None") -> Judgement:
    """Judge one case.

    Parameters
    ----------
    case, verdict
        What is there, and what was said.
    held_out
        Forces of the held-out record; None: the gap is not counted.
    """
    by_name = {named.name: named for named in verdict.effects}
    said = verdict.names.union(*(named.rivals for named in verdict.effects))
    places = [judged for effect in case.effects for judged in _places(effect, by_name.get(effect.name), verdict)]
    errors = [
        error for effect in case.effects if effect.name in by_name for error in _errors(effect, by_name[effect.name])
    ]
    gap = gap_closed(case, held_out) if held_out is not None else None
    return Judgement(case, verdict, case.names & said, tuple(places), tuple(errors), gap)


@dataclass(frozen=True)
class HeldOut:
    """Forces of the held-out record, shape (n,) [N].

    Parameters
    ----------
    true_N
        Noise-free, without what another record does not repeat.
    base_N, extended_N
        As the model without and with effects simulates it; None: it was not given.
    """

    true_N: Array
    base_N: Array | None
    extended_N: Array | None


def gap_closed(case: TrueCase, forces: HeldOut) -> float | None:
    """Share of the held-out gap that the extended model closes (1); None: not counted."""
    if not case.effects or case.foreign or case.names <= UNREPEATABLE:
        return None
    if forces.base_N is None or forces.extended_N is None:
        return 0.0
    before, after = _mean_square(forces.base_N - forces.true_N), _mean_square(forces.extended_N - forces.true_N)
    if before < (LEAST_GAP * case.noise_N) ** 2:
        return None
    return 1.0 - after / before if math.isfinite(after) and math.isfinite(before) else 0.0


def same_place(true: Place, found: Place) -> bool:
    """Whether a place found is the true one."""
    if true.axis != found.axis or (found.recording and true.recording and found.recording != true.recording):
        return False
    if true.axis == "time_s":
        return _same_span(true, found)
    if true.axis == "frequency_Hz":
        return abs(0.5 * (found.low + found.high) - true.low) <= LINE * abs(true.low)
    return abs(found.low - true.low) <= THRESHOLD * abs(true.low)


def _same_span(true: Place, found: Place) -> bool:
    if max(abs(true.low - found.low), abs(true.high - found.high)) <= EDGES_S:
        return True
    common = min(true.high, found.high) - max(true.low, found.low)
    union = max(true.high, found.high) - min(true.low, found.low)
    return union > 0.0 and common / union >= OVERLAP


def _places(effect: TrueEffect, named: Named | None, verdict: Verdict) -> list[PlaceJudged]:
    said = (*(named.where if named else ()), *verdict.where)
    return [PlaceJudged(effect.name, place, any(same_place(place, p) for p in said)) for place in effect.where]


def _errors(effect: TrueEffect, named: Named) -> list[ParameterError]:
    found = []
    for parameter, true in effect.parameters.items():
        if parameter in UNSCORED or true == 0.0:
            continue
        value = named.parameters.get(parameter, math.inf)
        found.append(ParameterError(effect.name, parameter, abs(value - true) / abs(true)))
    return found


def _mean_square(values: Array) -> float:
    return float(np.mean(values * values))
