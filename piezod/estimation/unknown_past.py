"""Columns for what was driven before a recording that begins amid the range.

A play of half-width r that was at z when the recording began is at clip(z, M - r, m + r) later. M and m are the highest
and the lowest input since. So an unknown past adds a function of M and m to the stroke. They change one at a time, so
that it is a function of the swept range M - m, fitted as straight pieces. When the plays have forgotten their past, a
shift of the zero is left. Effects that remember for longer add their decays.
Derived here from the definition of the play: M. Brokate and J. Sprekels (1996), Hysteresis and Phase Transitions, 2.1.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.operators import PrandtlIshlinskii

Array = NDArray[np.float64]

PIECES = 8  # at least, over the swept range; a piece ends where the other end of the range begins to grow
MOST_PIECES = 16
SHORTEST = 0.25  # of an equal piece: switches that lie closer share a piece
GROWN = 0.99  # of the whole swept range: equal cycles, sampled, still widen it a little
EQUAL = 0.01  # of the whole swept range, within which what the past adds counts as the same
PASTS = 24  # that are tried: any lies between four extreme ones; the others turn within the range


@dataclass(frozen=True)
class UnknownPast:
    """What an unknown past can have added to a stroke.

    Parameters
    ----------
    columns
        Straight pieces over the range swept so far, shape (N, K) [1].
    until
        Sample from which all columns stay as they are.
    known
        Where a fit of the columns leaves little of any past, and other samples tell the same size, shape (N,). From
        `until` on everywhere.
    """

    columns: Array
    until: int
    known: NDArray[np.bool_]


def unknown_past(
    u: Array, operator: Callable[[], PrandtlIshlinskii], ends: tuple[float, float], within: float, least: int = 1
) -> UnknownPast | None:
    """Columns for the past of a recording that begins amid the range; None where no past matters, but for a shift.

    Plays that never move shift the stroke for good: a last column is 1 from there on. Behind a curved force law such a
    shift is no tare.

    Parameters
    ----------
    u
        Input, shape (N,).
    operator
        Makes the operator, de-energised.
    ends
        Lowest and highest input that may have come before.
    within
        Difference of the strokes after two pasts that does not matter, above 0 [input unit].
    least
        Samples with the same swept range that make the size of a column known, 1 or more.
    """
    swept = np.maximum.accumulate(u) - np.minimum.accumulate(u)
    grows = np.concatenate(([0], np.flatnonzero(np.diff(swept) > 0.0) + 1))  # what a past adds changes there alone
    lasts = np.diff(np.append(grows, u.size))
    low, high = min(ends[0], float(u.min())), max(ends[1], float(u.max()))
    courses = np.array([_stroke(operator(), low + (high - low) * past, u[grows]) for past in _pasts()])
    stays = float(np.ptp(courses[:, -1])) > within
    courses -= courses[:, -1:]
    unknown = np.flatnonzero(np.ptp(courses, axis=0) > within)
    if not unknown.size:
        return None
    forgotten = int(lasts[: unknown[-1] + 1].sum())
    grown = int(np.searchsorted(swept, GROWN * swept[-1]))
    until = min(forgotten, max(grown, 1), u.size - 1)
    different = (courses - courses.mean(axis=0)).T
    for pieces in (PIECES, MOST_PIECES):
        knots = _knots(u[: until + 1], swept[: until + 1], pieces)
        hats = np.eye(knots.size) if stays else np.eye(knots.size)[:-1]
        columns = np.array([np.interp(np.minimum(swept, knots[-1]), knots, hat) for hat in hats]).reshape(-1, u.size).T
        left = np.abs(different - _fitted(different, columns[grows], lasts)).max(axis=1)
        if float(np.sqrt(np.mean(np.repeat(left, lasts)[: until + 1] ** 2))) < within:
            break
    bins = np.floor(swept / (EQUAL * max(swept[-1], 1e-12))).astype(int)
    known = (np.repeat(left, lasts) < within) & (np.bincount(bins)[bins] >= least)
    known[until:] = True
    return UnknownPast(columns, until, known)


def _fitted(values: Array, columns: Array, times: NDArray[np.int64]) -> Array:
    """What columns and a constant tell of values, by least squares; each row counts so many times."""
    rows = np.hstack((columns, np.ones((times.size, 1))))
    weights = np.sqrt(times)[:, None]
    fitted: Array = rows @ np.linalg.lstsq(weights * rows, weights * values, rcond=1e-9)[0]
    return fitted


def _pasts() -> list[Array]:
    """Pasts in parts of the range; the same at every call."""
    rng = np.random.default_rng(0)
    extreme = [np.array(path) for path in ((0.0,), (1.0,), (0.0, 1.0), (1.0, 0.0))]
    return extreme + [rng.uniform(size=rng.integers(1, 6)) for _ in range(PASTS - len(extreme))]


def _stroke(operator: PrandtlIshlinskii, past: Array, u: Array) -> Array:
    operator.run(past)
    return operator.stroke(u)


def _knots(u: Array, swept: Array, pieces: int) -> Array:
    """Swept ranges at which a piece ends, all of them seen, rising, shape (K,) [input unit].

    The slope of what the past adds changes its sign where the other end of the range begins to grow.
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
    """What an unknown past adds, as an error tells, shape (N,) [output unit].

    Parameters
    ----------
    error
        Measured less simulated, shape (N,); nan where nothing is known. Its mean is no part of the past.
    columns
        Those of `unknown_past` and decays of effects, shape (N, K) [1].
    """
    known = np.isfinite(error)
    constant = np.ones((np.count_nonzero(known), 1))
    sizes = np.linalg.lstsq(np.hstack((columns[known], constant)), error[known], rcond=1e-9)[0]
    past: Array = columns @ sizes[:-1]
    return past
