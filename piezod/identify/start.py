"""The memory that a recording starts with: known at rest, otherwise found from its first stretch.

Whatever happened before, what matters of it is a sequence of ever smaller reversals. Two of them are enough for a bench
that was used: one end of the range, a reversal, and the first sample.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from piezod.operators import PrandtlIshlinskii

Array = NDArray[np.float64]
Path = tuple[float, ...]

AT_REST = 0.02  # share of the input's swing around zero that counts as de-energised
REVERSALS_TRIED = 41


def starts_at_rest(u: Array) -> bool:
    """Whether the first input is near enough to zero for a de-energised start."""
    return bool(abs(u[0]) <= AT_REST * np.ptp(u))


def settled_from(u: Array) -> int:
    """First sample after which the start no longer matters to plays up to half the swing.

    That is when the input has reached both ends of its range.
    """
    low, high = u.min() + 0.01 * np.ptp(u), u.max() - 0.01 * np.ptp(u)
    return int(max(np.argmax(u <= low), np.argmax(u >= high)))


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
        errors.append(float(np.nansum((operator.run(u[:window]) - y[:window]) ** 2)))
    return paths[int(np.argmin(errors))]
