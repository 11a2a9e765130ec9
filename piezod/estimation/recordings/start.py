"""Initial state of the plays in a recording, as a sequence of earlier reversals.

A drive that starts at zero is de-energised, or was driven to a peak and back. The first rise decides: below an old peak
it is a branch inside the loop, above it the virgin curve. A drive that starts elsewhere came from an end of its range,
by one more reversal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.errors import ModelError, RecordingError
from piezod.operators import PrandtlIshlinskii

Path = tuple[float, ...]

AT_REST = 0.02  # share of the input's swing around zero that counts as a drive at zero
START_WINDOW_S = 20.0  # first part of a recording that a diagnosis estimates its start from
REVERSALS_TRIED = 41
PEAKS_TRIED = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)  # old peaks before a start at zero, as shares of the largest input
REFINEMENTS = 5  # bisections of the distance between tried peaks
CLEARLY = 0.8  # ratio of the squared errors with and without an old peak, below which the stack was driven before

DECAYING_SWINGS = (1.0, 0.8, 0.6, 0.4, 0.2)  # shares of the way to both ends of the range; they erase the memory
TURNS_TRIED = 7  # last reversals between the ends of the range, before a start amid it

CLIPPED_AT, LEAST_CLIPPED = 10.0, 0.01
"""Limits at which an error is clipped: multiples of the median error, and share of the output's swing.

While a bench follows a jump at the beginning, its errors carry no information on the past. The second limit serves for
records without noise, whose median error is zero.
"""

FAR_BETTER = 0.25  # ratio of the squared errors below which an estimated start replaces the model's start


def starts_at_rest(u: Array) -> bool:
    """Whether the first input is near zero, as of a drive that was off."""
    return bool(abs(u[0]) <= AT_REST * np.ptp(u))


def clipped_mean_square(error: Array, y: Array) -> float:
    """Mean square error with the largest errors clipped, nan where unknown; 0 without a finite error."""
    known = np.isfinite(error)
    if not known.any():
        return 0.0
    size = np.abs(error[known])
    most = max(CLIPPED_AT * float(np.median(size)), LEAST_CLIPPED * float(np.ptp(y[known])))
    return float(np.mean(np.minimum(size, most) ** 2))


def mean_square(error: Array, _: Array) -> float:
    """Mean square error."""
    return float(np.mean(error**2))


def tared_mean_square(error: Array, _: Array) -> float:
    """Mean square error without its median: the tare of the load cell is no error of a start."""
    return float(np.mean((error - np.median(error)) ** 2))


def output_after(operator: PrandtlIshlinskii, path: Path, u: Array) -> Array:
    """Output of an operator over an input after a path from the de-energised state, shape (N,); its states change."""
    operator.set_states(np.zeros(operator.plays[0].size))
    operator.run(np.array(path))
    return operator.run(u)


def loss_of_start(
    outputs: Callable[[Path], Array],
    y: Array,
    counts: NDArray[np.bool_],
    measure: Callable[[Array, Array], float] = mean_square,
) -> Callable[[Path], float]:
    """Loss of a start in the first samples, as a function of the path before them.

    Parameters
    ----------
    outputs
        Simulated output after a path, at least N samples; what is fitted anew for each path is up to it.
    y, counts
        Measured output, and mask of the samples that are compared, shape (N,).
    measure
        Loss of the errors and the measured output of these samples.
    """

    def loss(path: Path) -> float:
        return measure((y - outputs(path)[: y.size])[counts], y[counts])

    return loss


def wipe_out_sample(u: Array) -> int:
    """First sample at which the input has reached both ends of its range.

    From there on the start has no effect on plays up to half the swing (wiping-out property).
    """
    low, high = u.min() + 0.01 * np.ptp(u), u.max() - 0.01 * np.ptp(u)
    return int(max(np.argmax(u <= low), np.argmax(u >= high)))


@dataclass(frozen=True)
class Start:
    """Initial state of a recording."""

    path: Path  # inputs from the de-energised state up to the first sample; empty: it starts de-energised
    words: str


def start_at_zero(u: Array, unit: str, loss: Callable[[Path], float], reach: float = 0.0) -> Start:
    """Start of a drive from zero: driven to a peak before if that fits clearly better, else de-energised.

    Parameters
    ----------
    u
        Input from zero, shape (N,).
    loss
        Mean square error as a function of the path; raises `RecordingError` or `ModelError` if a fit fails.
    reach
        Largest old peak, if above the largest input [input unit].
    """
    extreme = max(float(u.max()), -float(u.min()), abs(reach), key=abs)
    sign = 1.0 if u.max() >= -u.min() else -1.0
    losses = {share: _loss_or_inf(loss, (sign * share * extreme, 0.0)) for share in PEAKS_TRIED}
    virgin = _loss_or_inf(loss, ())
    if min(losses.values()) >= virgin:
        return Start((), "de-energised")
    distance = 0.15
    for _ in range(REFINEMENTS):
        best, distance = min(losses, key=losses.__getitem__), 0.5 * distance
        for share in (best - distance, best + distance):
            if 0.0 < share <= 1.0 and share not in losses:
                losses[share] = _loss_or_inf(loss, (sign * share * extreme, 0.0))
    best = min(losses, key=losses.__getitem__)
    if losses[best] >= CLEARLY * virgin:
        return Start((), "de-energised")
    peak = sign * best * extreme
    return Start((peak, 0.0), f"driven to about {peak:.3g} {unit} and back before")


def start_amid(u: Array, unit: str, loss: Callable[[Path], float]) -> Start:
    """Start amid the range: the path with the least loss; parameters as for `start_at_zero`."""
    low, high, begin = float(u.min()), float(u.max()), float(u[0])
    shrinking = [begin + share * (end - begin) for share in DECAYING_SWINGS for end in (high, low)]
    paths: dict[Path, str] = {
        (begin,): f"driven from rest to {begin:.3g} {unit}",
        (high, begin): f"driven down to {begin:.3g} {unit}",
        (low, begin): f"driven up to {begin:.3g} {unit}",
        (low, high, begin): f"driven up, and down to {begin:.3g} {unit}",
        (high, low, begin): f"driven down, and up to {begin:.3g} {unit}",
        (*shrinking, begin): f"shaken about {begin:.3g} {unit} less and less",
    }
    for turn in np.linspace(low, high, TURNS_TRIED + 2)[1:-1].tolist():
        for end in (low, high):
            paths[end, turn, begin] = f"driven to about {turn:.3g} {unit} and back to {begin:.3g} {unit}"
    best = min(paths, key=lambda path: _loss_or_inf(loss, path))
    return Start(best, f"{paths[best]} before")


def _loss_or_inf(loss: Callable[[Path], float], path: Path) -> float:
    try:
        return loss(path)
    except (RecordingError, ModelError):
        return float("inf")


def estimate_start(
    operator: PrandtlIshlinskii, u: Array, y: Array, window: int, unit: str, reach: float
) -> Start | None:
    """Start of a recording, estimated from its first samples; None: the operator's present state fits as well.

    Parameters
    ----------
    operator
        In the start state of its model; its states change.
    u, y, window
        Input and output, shape (N,), and number of samples that are used, above 0.
    reach
        Largest input of the model.
    """
    if not starts_at_rest(u):
        return Start(estimate_path(operator, u, y, window), f"start found from the first {window} samples")

    if not np.isfinite(y[:window]).any():
        return None
    present = float(np.nanvar(operator.run(u[:window]) - y[:window]))  # variance: a tare is no old peak
    loss = loss_of_start(lambda path: output_after(operator, path, u[:window]), y[:window], np.isfinite(y[:window]))
    estimate = start_at_zero(u, unit, loss, reach)
    if loss(estimate.path) >= FAR_BETTER * present:
        return None
    return Start(estimate.path, f"{estimate.words}, found from the first {window} samples")


def estimate_path(operator: PrandtlIshlinskii, u: Array, y: Array, window: int) -> Path:
    """Path before the first sample with which `operator` fits the first `window` samples best; its states change."""
    low, high = float(u.min()), float(u.max())
    reversals = np.linspace(low, high, REVERSALS_TRIED).tolist()
    paths: list[Path] = [(0.0,), *((high, low, end, back) for end, back in product((low, high), reversals))]
    first = slice(0, window)
    known = np.isfinite(y[first])
    loss = loss_of_start(lambda path: output_after(operator, path, u[first]), y[first], known, clipped_mean_square)
    return min(paths, key=loss)
