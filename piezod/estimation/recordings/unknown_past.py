"""Columns for the unknown past of a recording that begins amid the range.

A play of half-width r that starts the recording at z is at clip(z, M - r, m + r) later. M and m are the highest and the
lowest input since then. So an unknown past adds a function of M and m to the stroke. Only M or m changes at a time, so
it is a function of the swept range M - m, fitted as straight pieces. When the plays have forgotten their past, a shift
of the zero remains. Effects with a longer memory add their decays.
Derived here from the definition of the play: M. Brokate and J. Sprekels (1996), Hysteresis and Phase Transitions, 2.1.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.operators import PrandtlIshlinskii

PIECES, MOST_PIECES = 8, 16  # straight pieces over the swept range; they also end where its other end begins to grow
SHORTEST = 0.25  # shortest piece, as share of an equal piece
GROWN = 0.99  # share of the final swept range at which it counts as complete; sampled equal cycles still widen it
EQUAL = 0.01  # share of the final swept range within which the contribution of the past counts as equal
PASTS = 24  # number of tried pasts: four extreme ones, between which any past lies, and random ones


@dataclass(frozen=True)
class UnknownPast:
    """Possible contributions of an unknown past to a stroke.

    Parameters
    ----------
    columns
        Straight pieces over the swept range, shape (N, K) [1].
    until
        Sample from which all columns are constant.
    known
        Samples at which a fit of the columns removes any past, shape (N,). Before `until`, a sample counts only if
        enough others have its swept range.
    """

    columns: Array
    until: int
    known: NDArray[np.bool_]


def unknown_past(
    u: Array, operator: Callable[[], PrandtlIshlinskii], ends: tuple[float, float], within: float, least: int = 1
) -> UnknownPast | None:
    """Columns for the past of a recording that begins amid the range; None: the past has no effect besides a shift.

    Plays that never move shift the stroke permanently: a last column is 1 from `until` on. With a curved force law such
    a shift is no tare.

    Parameters
    ----------
    operator
        Returns a de-energised operator.
    ends
        Lowest and highest possible input of the past.
    within
        Negligible difference of the strokes after two pasts, above 0 [input unit].
    least
        Number of samples with an equal swept range that determine the size of a column, 1 or more.
    """
    swept = np.maximum.accumulate(u) - np.minimum.accumulate(u)
    grows = np.concatenate(([0], np.flatnonzero(np.diff(swept) > 0.0) + 1))  # the contribution changes only there
    lasts = np.diff(np.append(grows, u.size))
    low, high = min(ends[0], float(u.min())), max(ends[1], float(u.max()))
    strokes = np.array([_stroke(operator(), low + (high - low) * past, u[grows]) for past in _pasts()])
    lasting = float(np.ptp(strokes[:, -1])) > within
    strokes -= strokes[:, -1:]
    unknown = np.flatnonzero(np.ptp(strokes, axis=0) > within)
    if not unknown.size:
        return None
    forgotten = int(lasts[: unknown[-1] + 1].sum())
    grown = int(np.searchsorted(swept, GROWN * swept[-1]))
    until = min(forgotten, max(grown, 1), u.size - 1)
    different = (strokes - strokes.mean(axis=0)).T
    for pieces in (PIECES, MOST_PIECES):
        knots = _knots(u[: until + 1], swept[: until + 1], pieces)
        hats = np.eye(knots.size) if lasting else np.eye(knots.size)[:-1]
        columns = np.array([np.interp(np.minimum(swept, knots[-1]), knots, hat) for hat in hats]).reshape(-1, u.size).T
        residual = np.abs(different - _fitted(different, columns[grows], lasts)).max(axis=1)
        if float(np.sqrt(np.mean(np.repeat(residual, lasts)[: until + 1] ** 2))) < within:
            break
    bins = np.floor(swept / (EQUAL * max(swept[-1], 1e-12))).astype(int)
    known = (np.repeat(residual, lasts) < within) & (np.bincount(bins)[bins] >= least)
    known[until:] = True
    return UnknownPast(columns, until, known)


def _fitted(values: Array, columns: Array, times: NDArray[np.int64]) -> Array:
    """Least-squares fit of the values by columns and a constant; `times` is the weight of each row."""
    rows = np.hstack((columns, np.ones((times.size, 1))))
    weights = np.sqrt(times)[:, None]
    fitted: Array = rows @ np.linalg.lstsq(weights * rows, weights * values, rcond=1e-9)[0]
    return fitted


def _pasts() -> list[Array]:
    """Pasts as shares of the range, equal at every call."""
    rng = np.random.default_rng(0)
    extreme = [np.array(path) for path in ((0.0,), (1.0,), (0.0, 1.0), (1.0, 0.0))]
    return extreme + [rng.uniform(size=rng.integers(1, 6)) for _ in range(PASTS - len(extreme))]


def _stroke(operator: PrandtlIshlinskii, past: Array, u: Array) -> Array:
    operator.run(past)
    return operator.stroke(u)


def _knots(u: Array, swept: Array, pieces: int) -> Array:
    """Ends of the straight pieces among the swept ranges, rising, shape (K,) [input unit].

    The slope of the contribution changes its sign where the other end of the range begins to grow.
    """
    above, below = np.diff(np.maximum.accumulate(u)) > 0.0, np.diff(np.minimum.accumulate(u)) < 0.0
    grows = np.flatnonzero(above | below)
    switches = swept[grows[1:][above[grows[1:]] != above[grows[:-1]]]]
    piece = swept[-1] / pieces
    ends = [0.0]
    for switch in switches:
        if switch - ends[-1] > SHORTEST * piece and swept[-1] - switch > SHORTEST * piece:
            ends.append(float(switch))
    ends.append(float(swept[-1]))
    wanted = [np.linspace(a, b, 1 + max(int(np.ceil((b - a) / piece)), 1)) for a, b in itertools.pairwise(ends)]
    return np.unique(swept[np.searchsorted(swept, np.concatenate(wanted))])


def fitted_past(error: Array, columns: Array) -> Array:
    """Contribution of an unknown past, fitted to an error, shape (N,) [output unit].

    Parameters
    ----------
    error
        Measured minus simulated, shape (N,), nan where unknown; its mean is not attributed to the past.
    columns
        Columns of `unknown_past` and decays of effects, shape (N, K) [1].
    """
    known = np.isfinite(error)
    constant = np.ones((np.count_nonzero(known), 1))
    sizes = np.linalg.lstsq(np.hstack((columns[known], constant)), error[known], rcond=1e-9)[0]
    past: Array = columns @ sizes[:-1]
    return past
