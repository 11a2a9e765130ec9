"""Score of one case: which effects were named correctly, which wrongly, and with which errors.

Definitions
-----------
exact set
    The names given are exactly the catalogue effects of the case.
alarm (null case)
    A name was given, or the verdict is `explained`, `partly_explained` or `unexplained`.
covered
    The true effect is among the names given, or among the rivals of one of them.
flagged (foreign case, unrecorded input)
    The verdict is `unexplained` or `partly_explained`.
confident name (foreign case, unrecorded input)
    The verdict is `explained`, or a wrong name was given with a confidence of at least 0.9.
place found
    The finding of the effect, or else the finding of the whole mismatch, has a matching place on the same axis.
    Time spans match when they overlap by at least half of their union, or when both ends agree within 0.1 s.
    Frequencies match within 2 %. The rate or voltage above which an effect acts (`low`) matches within 10 %.
    A place in another recording does not match.
parameter error
    |found - true| / |true| of a correctly named effect; a wrong sign gives an error above 100 %.
gap closed
    (e0^2 - e1^2) / e0^2 on the held-out record. e0 is the rms error of the model without effects, e1 that of the
    extended model. Both compare with the noise-free force without tones, single events and converter steps.
    In expectation this equals (e0^2 - e1^2) / (e0^2 - noise^2) with errors against the measurement.
    Not counted: e0 is below half of the noise rms, or no effect of the case repeats in another record.
    A missing or infinite simulation counts as 0.
    Of records with a tare, both errors are without their mean. The noise of a recorded voltage, which every simulation
    contains, is subtracted from both squares.
"""

import math
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.scoring.verdicts import NamedEffect, Verdict
from firmware_sim.concealed.study.catalogue import UNREPEATABLE
from firmware_sim.concealed.study.truth import Place, TrueCase, TrueEffect

CONFIDENT = 0.9
OVERLAP, EDGES_S = 0.5, 0.1  # of time spans: overlap / union, distance of the ends
LINE, THRESHOLD = 0.02, 0.10  # relative distance of frequencies, and of rates or voltages
LEAST_GAP = 0.5  # [noise rms]
UNSCORED = frozenset({"from_s", "to_s", "reference_V_per_s", "on_s", "off_s"})
"""Parameters without an error: spans beyond the records, a reference that depends on its growth, and times (places)."""


@dataclass(frozen=True)
class ParameterError:
    """Relative error of a parameter (1)."""

    effect: str
    parameter: str
    error: float


@dataclass(frozen=True)
class PlaceScore:
    """A true place, and whether it was found."""

    effect: str
    place: Place
    found: bool


@dataclass(frozen=True)
class CaseScore:
    """Score of one case; the docstring of the module defines the terms.

    Parameters
    ----------
    case
        Truth.
    verdict
        Findings of the diagnosis.
    covered
        True effects among the names or their rivals.
    places
        Places of the true effects.
    errors
        Parameter errors of the correctly named effects.
    gap_closed
        Share of the held-out gap that is closed (1); None: not counted.
    """

    case: TrueCase
    verdict: Verdict
    covered: frozenset[str]
    places: tuple[PlaceScore, ...]
    errors: tuple[ParameterError, ...]
    gap_closed: float | None

    @property
    def exact(self) -> bool:
        """Whether the exact set was named."""
        return self.verdict.names == self.case.names

    @property
    def alarm(self) -> bool:
        """Whether the diagnosis reported any effect or mismatch."""
        return bool(self.verdict.names) or self.verdict.verdict not in {"matches", "not_testable"}

    @property
    def confident_name(self) -> bool:
        """Whether a foreign effect was given a confident name."""
        wrong = [named for named in self.verdict.effects if named.name not in self.case.names]
        return self.verdict.verdict == "explained" or any(named.confidence >= CONFIDENT for named in wrong)

    @property
    def names_right(self) -> tuple[tuple[float, bool], ...]:
        """Confidence of each name given, and whether the name is true."""
        return tuple((named.confidence, named.name in self.case.names) for named in self.verdict.effects)


def score_case(case: TrueCase, verdict: Verdict, held_out: "HeldOut | None") -> CaseScore:
    """Score one case.

    Parameters
    ----------
    case
        Truth.
    verdict
        Findings of the diagnosis.
    held_out
        Forces of the held-out record; None: the gap is not counted.
    """
    by_name = {named.name: named for named in verdict.effects}
    named_or_rival = verdict.names.union(*(named.rivals for named in verdict.effects))
    places = [place for effect in case.effects for place in _places(effect, by_name.get(effect.name), verdict)]
    errors = [
        error for effect in case.effects if effect.name in by_name for error in _errors(effect, by_name[effect.name])
    ]
    gap = gap_closed(case, held_out) if held_out is not None else None
    return CaseScore(case, verdict, case.names & named_or_rival, tuple(places), tuple(errors), gap)


@dataclass(frozen=True)
class HeldOut:
    """Forces of the held-out record, shape (n,) [N].

    Parameters
    ----------
    true_N
        Noise-free force without tones, single events and converter steps.
    base_N
        Simulation by the model without effects; None: missing.
    extended_N
        Simulation by the extended model; None: missing.
    """

    true_N: Array
    base_N: Array | None
    extended_N: Array | None


def gap_closed(case: TrueCase, forces: HeldOut) -> float | None:
    """Share of the held-out gap that the extended model closes (1); None: not counted.

    Parameters
    ----------
    case
        True case.
    forces
        True and simulated forces of the held-out record [N].
    """
    if not case.effects or case.foreign or case.names <= UNREPEATABLE:
        return None
    if forces.base_N is None or forces.extended_N is None:
        return 0.0
    before, after = (_error_square(case, values_N - forces.true_N) for values_N in (forces.base_N, forces.extended_N))
    if before < (LEAST_GAP * case.noise_N) ** 2:
        return None
    return 1.0 - after / before if math.isfinite(after) and math.isfinite(before) else 0.0


def same_place(true: Place, found: Place) -> bool:
    """Whether a reported place matches a true one.

    Parameters
    ----------
    true, found
        Place of the truth and place of the findings.
    """
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


def _places(effect: TrueEffect, named: NamedEffect | None, verdict: Verdict) -> list[PlaceScore]:
    reported = (*(named.where if named else ()), *verdict.where)
    return [PlaceScore(effect.name, place, any(same_place(place, p) for p in reported)) for place in effect.where]


def _errors(effect: TrueEffect, named: NamedEffect) -> list[ParameterError]:
    found = []
    for parameter, true in effect.parameters.items():
        if parameter in UNSCORED or true == 0.0:
            continue
        value = named.parameters.get(parameter, math.inf)
        found.append(ParameterError(effect.name, parameter, abs(value - true) / abs(true)))
    return found


def _error_square(case: TrueCase, error_N: Array) -> float:
    """Mean square of an error without the noise of the voltmeter, and without its mean where records have a tare."""
    if case.tared:
        error_N = error_N - error_N.mean()
    return max(float(np.mean(error_N * error_N)) - case.input_noise_N**2, 0.0)
