"""One-sided dead-zone operators with weights: the memoryless, asymmetric half of the modified Prandtl-Ishlinskii operator.

    S_r(x) = max(x - r, 0) for r > 0,   x for r = 0,   min(x - r, 0) for r < 0        (3.6)
    y = sum_j w_j S_{r_j}(x)                                                          (3.7)

Unipolar: thresholds 0 = r_0 < ... < r_m. Two-sided: thresholds on both sides of 0. The step works on
`packed[base : base + 2 * count]`: thresholds, weights. It allocates nothing.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.errors import ModelError
from piezod.operators.play import check_superposition, inverse_table

Array = NDArray[np.float64]


@numba.njit(cache=True)
def dead_zone_step(packed: Array, base: int, count: int, x: float) -> float:
    """Weighted sum of the dead zones at `x`."""
    y = 0.0
    for j in range(count):
        r = packed[base + j]
        beyond = x - r
        if r == 0.0 or (r > 0.0) == (beyond > 0.0):
            y += packed[base + count + j] * beyond
    return y


def split(thresholds: Array, weights: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Both sides as superpositions that start at 0 and grow outwards: (upper, lower), each (thresholds, weights)."""
    (centre,) = np.flatnonzero(thresholds == 0.0)
    upper = thresholds[centre:], weights[centre:]
    lower = -thresholds[centre::-1], weights[centre::-1]
    return upper, lower


def inverse_dead_zone(thresholds: Array, weights: Array) -> tuple[Array, Array]:
    """Thresholds and weights of the inverse (3.31-3.33, 3.35, 3.36); applied twice it gives back its input."""
    upper, lower = split(thresholds, weights)
    upper_thresholds, upper_weights = inverse_table(*upper)
    lower_thresholds, lower_weights = inverse_table(*lower)
    return (
        np.concatenate((-lower_thresholds[:0:-1], upper_thresholds)),
        np.concatenate((lower_weights[:0:-1], upper_weights)),
    )


def check_dead_zone(thresholds: Array, weights: Array, eps: float) -> None:
    """Refuse dead zones that have no inverse.

    `eps` is a fraction of the steepest slope, so that the check does not depend on the output's unit.

    Raises
    ------
    ModelError
        Names side, index and value.
    """
    if np.count_nonzero(thresholds == 0.0) != 1 or thresholds.shape != weights.shape:
        raise ModelError(
            f"dead zones: {thresholds.size} thresholds and {weights.size} weights, must be as many, one threshold being 0"
        )
    upper, lower = split(thresholds, weights)
    steepest = max(float(np.abs(np.cumsum(side[1])).max()) for side in (upper, lower))
    check_superposition("dead zones above 0", *upper, eps * steepest)
    check_superposition("dead zones below 0", *lower, eps * steepest)
