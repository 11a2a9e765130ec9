"""The memory that a recording starts with: whatever happened before, what matters of it is a sequence of reversals.

A drive that starts at zero is de-energised, or it was driven to some peak and back. Which of them shows in the first
rise: below the old peak it runs on a branch inside the loop, above it on the virgin curve. One that starts elsewhere
has come from an end of its range by one more reversal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from piezod.errors import ModelError, RecordingError
from piezod.operators import PrandtlIshlinskii

Array = NDArray[np.float64]
Path = tuple[float, ...]

AT_REST = 0.02  # share of the input's swing around zero that counts as a drive at zero
REVERSALS_TRIED = 41
PEAKS_TRIED = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)  # of the largest input, old peaks before a start at zero
REFINEMENTS = 5  # of the old peak, each halves the distance between two that are tried
CLEARLY = 0.8  # share of the squared error below which a used stack is taken rather than a virgin one

SHAKEN = (1.0, 0.8, 0.6, 0.4, 0.2)  # of the way to both ends, a course that leaves the stack without a memory
TURNS_TRIED = 7  # last reversals between the ends of the range, before a start amid it

CLIPPED_AT, LEAST_CLIPPED = 10.0, 0.01
"""Median errors, and at least a share of the output's swing, at which an error is clipped.

A bench that still follows a jump at the begin says nothing of its past. Without noise the median error is zero.
"""

FAR_BETTER = 0.25  # share of a given start's squared error below which another is taken for a model that stays


def starts_at_rest(u: Array) -> bool:
    """Whether the first input is near enough to zero for a drive that was off."""
    return bool(abs(u[0]) <= AT_REST * np.ptp(u))


def clipped_mean_square(error: Array, y: Array) -> float:
    """Mean square of errors, the largest of them clipped; 0 where nothing is known.

    Parameters
    ----------
    error
        Shape (N,) [output unit]; nan where nothing is known.
    y
        The output, shape (N,) [output unit].
    """
    known = np.isfinite(error)
    if not known.any():
        return 0.0
    size = np.abs(error[known])
    most = max(CLIPPED_AT * float(np.median(size)), LEAST_CLIPPED * float(np.ptp(y[known])))
    return float(np.mean(np.minimum(size, most) ** 2))


def settled_from(u: Array) -> int:
    """First sample after which the start no longer matters to plays up to half the swing.

    That is when the input has reached both ends of its range.
    """
    low, high = u.min() + 0.01 * np.ptp(u), u.max() - 0.01 * np.ptp(u)
    return int(max(np.argmax(u <= low), np.argmax(u >= high)))


@dataclass(frozen=True)
class Start:
    """How a drive came to a recording's first sample.

    Parameters
    ----------
    path
        Inputs since the de-energised state, before the first sample; empty: it starts de-energised.
    words
        The same for people.
    """

    path: Path
    words: str


def start_at_zero(u: Array, unit: str, loss: Callable[[Path], float], reach: float = 0.0) -> Start:
    """De-energised, or driven to a peak and back before: whichever a fit prefers clearly.

    Parameters
    ----------
    u
        Input, shape (N,), from zero.
    unit
        Of the input.
    loss
        Mean square error of a fit whose recording starts after these inputs; raises `RecordingError` where there is
        none.
    reach
        How large an old peak may have been where that is more than the largest input.
    """

    def tried(path: Path) -> float:
        try:
            return loss(path)
        except (RecordingError, ModelError):
            return float("inf")

    extreme = max(float(u.max()), -float(u.min()), abs(reach), key=abs)
    sign = 1.0 if u.max() >= -u.min() else -1.0
    losses = {share: tried((sign * share * extreme, 0.0)) for share in PEAKS_TRIED}
    virgin = tried(())
    if min(losses.values()) >= virgin:
        return Start((), "de-energised")
    distance = 0.15
    for _ in range(REFINEMENTS):
        best, distance = min(losses, key=losses.__getitem__), 0.5 * distance
        for share in (best - distance, best + distance):
            if 0.0 < share <= 1.0 and share not in losses:
                losses[share] = tried((sign * share * extreme, 0.0))
    best = min(losses, key=losses.__getitem__)
    if losses[best] >= CLEARLY * virgin:
        return Start((), "de-energised")
    peak = sign * best * extreme
    return Start((peak, 0.0), f"driven to about {peak:.3g} {unit} and back before")


def start_amid(u: Array, unit: str, loss: Callable[[Path], float]) -> Start:
    """What led to a start amid the range: whichever course a fit likes best.

    Parameters
    ----------
    u
        Input, shape (N,).
    unit
        Of the input.
    loss
        As for `start_at_zero`.
    """
    low, high, begin = float(u.min()), float(u.max()), float(u[0])
    shrinking = [begin + share * (end - begin) for share in SHAKEN for end in (high, low)]
    courses: dict[Path, str] = {
        (begin,): f"driven from rest to {begin:.3g} {unit}",
        (high, begin): f"driven down to {begin:.3g} {unit}",
        (low, begin): f"driven up to {begin:.3g} {unit}",
        (low, high, begin): f"driven up, and down to {begin:.3g} {unit}",
        (high, low, begin): f"driven down, and up to {begin:.3g} {unit}",
        (*shrinking, begin): f"shaken about {begin:.3g} {unit} less and less",
    }
    for turn in np.linspace(low, high, TURNS_TRIED + 2)[1:-1].tolist():
        for end in (low, high):
            courses[end, turn, begin] = f"driven to about {turn:.3g} {unit} and back to {begin:.3g} {unit}"
    losses = {}
    for path in courses:
        try:
            losses[path] = loss(path)
        except (RecordingError, ModelError):
            losses[path] = float("inf")
    best = min(losses, key=losses.__getitem__)
    return Start(best, f"{courses[best]} before")


def start_found(operator: PrandtlIshlinskii, u: Array, y: Array, window: int, unit: str, reach: float) -> Start | None:
    """What led to the start of a recording, as its first samples tell; None where the operator's own start does.

    Parameters
    ----------
    operator
        As its model starts; it is moved.
    u, y
        Input and output, shape (N,).
    window
        How many samples are looked at.
    unit
        Of the input.
    reach
        The model's largest input.
    """
    if not starts_at_rest(u):
        return Start(estimate_path(operator, u, y, window), f"start found from the first {window} samples")

    def loss(path: Path) -> float:
        operator.set_states(np.zeros(operator.plays[0].size))
        operator.run(np.array(path))
        return float(np.nanmean(np.square(operator.run(u[:window]) - y[:window])))

    if not np.isfinite(y[:window]).any():
        return None
    own = float(np.nanvar(operator.run(u[:window]) - y[:window]))  # a tare is no old peak
    found = start_at_zero(u, unit, loss, reach)
    if loss(found.path) >= FAR_BETTER * own:
        return None
    return Start(found.path, f"{found.words}, found from the first {window} samples")


def estimate_path(operator: PrandtlIshlinskii, u: Array, y: Array, window: int) -> Path:
    """Inputs that lead to the start under which `operator` fits the first `window` samples best.

    Parameters
    ----------
    operator
        Any start state; it is moved.
    u, y
        Input and output, shape (N,).
    window
        How many samples are looked at.
    """
    low, high = float(u.min()), float(u.max())
    reversals = np.linspace(low, high, REVERSALS_TRIED).tolist()
    paths: list[Path] = [(0.0,), *((high, low, end, back) for end, back in product((low, high), reversals))]
    nothing = np.zeros(operator.plays[0].size)
    errors = []
    for path in paths:
        operator.set_states(nothing)
        operator.run(path)
        errors.append(clipped_mean_square(operator.run(u[:window]) - y[:window], y[:window]))
    return paths[int(np.argmin(errors))]
