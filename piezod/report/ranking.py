"""The better of several models: by rms error, then by hysteresis, both compared in units of the noise."""

from collections.abc import Mapping
from dataclasses import dataclass

from piezod.diagnose.verdict.words import rounded

EQUAL_NOISES = 0.1
"""Rms errors closer than this multiple of the noise are equal: the noise is known to 5 %, so its excess to 10 %."""


@dataclass(frozen=True)
class Score:
    """Rms error, and width of the widest loop (None: none was closed), both in the output's unit."""

    rms: float
    hysteresis: float | None = None


def equal_to_best(scores: Mapping[str, Score], noise: float | None) -> list[str]:
    """Names whose rms error exceeds the least one by at most `EQUAL_NOISES`.

    Parameters
    ----------
    scores
        Scores by name, at least one.
    noise
        Rms noise [output unit]; None: unknown, then only equal errors are equal.
    """
    least = min(score.rms for score in scores.values())
    return [name for name, score in scores.items() if score.rms <= least + EQUAL_NOISES * (noise or 0.0)]


def best_of(scores: Mapping[str, Score], noise: float | None) -> str:
    """Name with the least rms error; among equal ones the name with the least hysteresis.

    Parameters
    ----------
    scores, noise
        As for `equal_to_best`.
    """
    equal = equal_to_best(scores, noise)
    widths = {name: scores[name].hysteresis for name in equal}
    known = {name: width for name, width in widths.items() if width is not None}
    if len(known) == len(equal):
        return min(known, key=lambda name: (known[name], scores[name].rms))
    return min(equal, key=lambda name: scores[name].rms)


def in_noises(value: float, noise: float | None, unit: str) -> str:
    """An error as a multiple of the noise, or in its unit if the noise is unknown.

    Parameters
    ----------
    value, noise
        Error and rms noise [unit].
    unit
        Unit as printed.
    """
    return f"{rounded(value)} {unit}" if not noise else f"{rounded(value / noise)} noises"


def gain_text(name: str, other: str, scores: Mapping[str, Score], noise: float | None, unit: str) -> str:
    """How much smaller the rms error of a model is than that of another one, in noises.

    Parameters
    ----------
    name, other
        Names in `scores`.
    """
    own_rms, other_rms = scores[name].rms, scores[other].rms
    if other in equal_to_best({name: scores[name], other: scores[other]}, noise):
        return f"{name} and {other} do not differ by more than the noise shows"
    return f"{name} is better than {other} by {in_noises(other_rms - own_rms, noise, unit)}"
