"""Columns for what was driven before a recording that begins amid the range.

A play of half-width r that was at z when the recording began is at clip(z, M - r, m + r) later. M and m are the highest
and the lowest input since. So an unknown past adds a function of M and m to the stroke. They change one at a time, so
that it is a function of the swept range M - m, fitted as straight pieces. When the plays have forgotten their past, a
shift of the zero is left. Effects that remember for longer add their decays.
Derived here from the definition of the play: M. Brokate and J. Sprekels (1996), Hysteresis and Phase Transitions, 2.1.
"""

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from piezod.operators import PrandtlIshlinskii

Array = NDArray[np.float64]

PIECES = 8  # at least, over the swept range; a piece ends where the other end of the range begins to grow
SHORTEST = 0.25  # of an equal piece: switches that lie closer share a piece
GROWN = 0.99  # of the whole swept range: equal cycles, sampled, still widen it a little


def forgotten_at(u: Array, operator: Callable[[], PrandtlIshlinskii], ends: tuple[float, float], within: float) -> int:
    """Sample from which an operator no longer depends on its past, but for a shift; 0: from the first.

    Parameters
    ----------
    u
        Input, shape (N,).
    operator
        Makes the operator, de-energised.
    ends
        Lowest and highest input that may have come before.
    within
        Largest difference of the outputs after different pasts [output unit].
    """
    low, high = min(ends[0], float(u.min())), max(ends[1], float(u.max()))
    courses = []
    for path in ((low,), (high,), (low, high), (high, low)):  # any other past lies between these
        driven = operator()
        driven.run(np.array(path))
        course = driven.run(u)
        courses.append(course - course[-1])
    unknown = np.flatnonzero(np.ptp(courses, axis=0) > within)
    return min(int(unknown[-1]) + 1, u.size - 1) if unknown.size else 0


def swept_columns(u: Array, forgotten: int) -> tuple[Array, int]:
    """Straight pieces over the range swept so far, 0 from a sample on, shape (N, K) [1], and that sample.

    Where the past matters for longer than the range grows, plays that never move shift the stroke for good: a last
    column is 1 from there on.

    Parameters
    ----------
    u
        Input, shape (N,).
    forgotten
        The sample from which the past no longer matters, above 0.
    """
    swept = np.maximum.accumulate(u) - np.minimum.accumulate(u)
    grown = int(np.searchsorted(swept, GROWN * swept[-1]))
    last = min(forgotten, max(grown, 1))
    knots = _knots(u[: last + 1], swept[: last + 1])
    within = np.minimum(swept, knots[-1])
    hats = np.eye(knots.size) if forgotten > grown else np.eye(knots.size)[:-1]
    return np.array([np.interp(within, knots, hat) for hat in hats]).reshape(-1, u.size).T, last


def _knots(u: Array, swept: Array) -> Array:
    """Swept ranges at which a piece ends, all of them seen, rising, shape (K,) [input unit].

    The slope of what the past adds changes its sign where the other end of the range begins to grow.
    """
    above, below = np.diff(np.maximum.accumulate(u)) > 0.0, np.diff(np.minimum.accumulate(u)) < 0.0
    grows = np.flatnonzero(above | below)
    switches = swept[grows[1:][above[grows[1:]] != above[grows[:-1]]]]
    piece = swept[-1] / PIECES
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
        Those of `swept_columns` and decays of effects, shape (N, K) [1].
    """
    known = np.isfinite(error)
    constant = np.ones((np.count_nonzero(known), 1))
    sizes = np.linalg.lstsq(np.hstack((columns[known], constant)), error[known], rcond=1e-9)[0]
    past: Array = columns @ sizes[:-1]
    return past
