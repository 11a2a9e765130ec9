"""The figures of a study, each with its requirement and its aim.

Cases and names that a figure counts:

- exact sets: singles (at 4 and 20 times the noise, and at 0.8 times), pairs and triples;
- precision: every name given in every case, nulls and foreign cases included; a name is right if it is in the case;
- truth among named or rivals: every catalogue effect of every case;
- false "unexplained": singles, pairs and triples whose exact set was named;
- places: those of the catalogue effects of every case;
- parameters: those of the correctly named effects. Lag, delay and frequency are `time_constant_s` of the electrical
  lag, `delay_s` and `frequency_Hz`;
- calibration: names in ten equal bins of confidence; mean over all names of |share right - mean confidence| of the bin;
- time: median over the cases that report a time.

Intervals: Wilson (1927), Probable inference, the law of succession, and statistical inference, at 95 %.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.scoring.case_score import CaseScore, ParameterError

BINS = 10
FALSELY_OPEN = 'false "unexplained" on solved cases'
Z = 1.959964  # quantile of the normal distribution for 95 %
STRONG = 2.0  # [noise rms], between the weakest strength and the others
FAST_PARAMETERS = frozenset({("electrical_lag", "time_constant_s"), ("transport_delay", "delay_s")})


@dataclass(frozen=True)
class Figure:
    """One line of the table.

    Parameters
    ----------
    value
        Value, in the unit of `least` and `aim`; None: nothing to count.
    count
        Number of counted cases, names or places.
    least, aim
        Requirement and aim.
    rising
        True: larger is better.
    interval
        Interval of a share at 95 %; None: the value is no share.
    percent
        True: shown in percent.
    """

    name: str
    value: float | None
    count: int
    least: float
    aim: float
    rising: bool = True
    interval: tuple[float, float] | None = None
    percent: bool = True

    @property
    def reached(self) -> str:
        """`aim`: aim reached; `yes`: requirement reached; `no`; `-`: nothing to count."""
        if self.value is None:
            return "-"
        for limit, word in ((self.aim, "aim"), (self.least, "yes")):
            if (self.value >= limit) if self.rising else (self.value <= limit):
                return word
        return "no"


@dataclass(frozen=True)
class ConfidenceBin:
    """Names in a range of confidence: their number, mean confidence and share of right names."""

    low: float
    high: float
    count: int
    confidence: float
    right: float


def figures(scores: Sequence[CaseScore]) -> list[Figure]:
    """All figures of a study, in the order of the table.

    Parameters
    ----------
    scores
        Score of every case of the study.
    """
    kinds = ("null", "single", "pair", "triple", "foreign", "unrecorded")
    of_kind = {kind: [j for j in scores if j.case.kind == kind] for kind in kinds}
    foreign = of_kind["foreign"] + of_kind["unrecorded"]
    strong = [j for j in of_kind["single"] if j.case.effects[0].strength >= STRONG]
    weak = [j for j in of_kind["single"] if j.case.effects[0].strength < STRONG]
    solved = [j for kind in ("single", "pair", "triple") for j in of_kind[kind] if j.exact]
    right = [is_right for j in scores for _, is_right in j.names_right]
    covered = [effect.name in j.covered for j in scores for effect in j.case.effects]
    places = [place.found for j in scores for place in j.places]
    return [
        _share("false alarm on nulls", _each(of_kind["null"], lambda j: j.alarm), 0.05, 0.0, rising=False),
        _share("singles, exact set, 4x and 20x noise", _each(strong, _exact), 0.90, 0.97),
        _share("singles, exact set, 0.8x noise", _each(weak, _exact), 0.80, 0.92),
        _share("pairs, exact set", _each(of_kind["pair"], _exact), 0.75, 0.88),
        _share("triples, exact set", _each(of_kind["triple"], _exact), 0.60, 0.78),
        _share("precision over all names given", right, 0.95, 0.98),
        _share("truth among named or their rivals", covered, 0.95, 0.98),
        _share("foreign effects flagged", _each(foreign, _flagged), 0.90, 0.97),
        _share("foreign effects given a confident name", _each(foreign, _confident), 0.10, 0.03, rising=False),
        _share(FALSELY_OPEN, _each(solved, _flagged), 0.05, 0.02, rising=False),
        _share("places found", places, 0.85, 0.95),
        *_parameters(scores),
        *_gaps(scores),
        _calibration(scores),
        _time(scores),
    ]


def calibration_bins(scores: Iterable[CaseScore]) -> list[ConfidenceBin]:
    """Names in equal bins of confidence, empty bins left out.

    Parameters
    ----------
    scores
        Score of every case of the study.
    """
    names = [name for j in scores for name in j.names_right]
    bins = []
    for k in range(BINS):
        inside = [(c, r) for c, r in names if min(int(min(max(c, 0.0), 1.0) * BINS), BINS - 1) == k]
        if inside:
            confidence, right = (float(np.mean(column)) for column in zip(*inside, strict=True))
            bins.append(ConfidenceBin(k / BINS, (k + 1) / BINS, len(inside), confidence, right))
    return bins


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Wilson's interval of a share at 95 % (1).

    Parameters
    ----------
    hits
        Number of hits, 0 to `count`.
    count
        Number of trials, at least 1.
    """
    middle = (hits + 0.5 * Z * Z) / (count + Z * Z)
    half = Z / (count + Z * Z) * math.sqrt(hits * (count - hits) / count + 0.25 * Z * Z)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _each(scores: Iterable[CaseScore], test: Callable[[CaseScore], bool]) -> list[bool]:
    return [test(j) for j in scores]


def _flagged(score: CaseScore) -> bool:
    return score.verdict.flagged


def _exact(score: CaseScore) -> bool:
    return score.exact


def _confident(score: CaseScore) -> bool:
    return score.confident_name


def _share(name: str, hits: Sequence[bool], least: float, aim: float, *, rising: bool = True) -> Figure:
    if not hits:
        return Figure(name, None, 0, least, aim, rising)
    interval = wilson(sum(hits), len(hits))
    return Figure(name, sum(hits) / len(hits), len(hits), least, aim, rising, interval)


def _parameters(scores: Sequence[CaseScore]) -> list[Figure]:
    def fast(error: ParameterError) -> bool:
        return error.parameter == "frequency_Hz" or (error.effect, error.parameter) in FAST_PARAMETERS

    errors = [error for j in scores for error in j.errors]
    of_fast, of_others = [e.error for e in errors if fast(e)], [e.error for e in errors if not fast(e)]
    name = "parameter error, median"
    return [
        Figure(f"{name}: lag, delay, frequency", _quantile(of_fast, 0.5), len(of_fast), 0.02, 0.005, rising=False),
        Figure(f"{name}: others", _quantile(of_others, 0.5), len(of_others), 0.10, 0.03, rising=False),
    ]


def _gaps(scores: Sequence[CaseScore]) -> list[Figure]:
    gaps = [j.gap_closed for j in scores if j.gap_closed is not None]
    name = "held-out gap closed"
    return [
        Figure(f"{name}, median", _quantile(gaps, 0.5), len(gaps), 0.98, 0.998, percent=False),
        Figure(f"{name}, 10th percentile", _quantile(gaps, 0.1), len(gaps), 0.90, 0.98, percent=False),
    ]


def _calibration(scores: Sequence[CaseScore]) -> Figure:
    bins = calibration_bins(scores)
    count = sum(b.count for b in bins)
    error = sum(b.count * abs(b.right - b.confidence) for b in bins) / count if count else None
    return Figure("calibration error of the confidence (ECE)", error, count, 0.05, 0.03, rising=False, percent=False)


def _time(scores: Sequence[CaseScore]) -> Figure:
    times = [j.verdict.elapsed_s for j in scores if j.verdict.elapsed_s is not None]
    return Figure("time a case, median [s]", _quantile(times, 0.5), len(times), 60.0, 10.0, rising=False, percent=False)


def _quantile(values: Sequence[float], share: float) -> float | None:
    """Quantile by linear interpolation between the ranks, infinite values allowed; None without values."""
    if not values:
        return None
    ordered = sorted(values)
    rank = share * (len(ordered) - 1)
    low, high = ordered[math.floor(rank)], ordered[math.ceil(rank)]
    return low if low == high else low + (rank - math.floor(rank)) * (high - low)
