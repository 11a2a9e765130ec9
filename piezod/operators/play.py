"""Play (backlash) operators with weights, stepped one sample at a time in a packed array.

A play of threshold r lets its input move by r either way before its state z follows:

    z(k) = max(u(k) - r, min(u(k) + r, z(k-1)))                       (3.1)
    v(k) = sum_i w_i z_i(k),   0 = r_0 < r_1 < ... < r_n              (3.4)

The steps work on `packed[base : base + 3 * count]`: thresholds, weights, states, each `count` long. They allocate
nothing.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.errors import ModelError

Array = NDArray[np.float64]

THRESHOLD, WEIGHT, STATE = 0, 1, 2  # which third of the block
MOST_NEWTON = 60  # steps; as many as pieces at the most, and some to close in


@numba.njit(cache=True)
def play_step(packed: Array, base: int, count: int, u: float) -> float:
    """Move every play to input `u` and return the weighted sum of the states."""
    v = 0.0
    weights, states = base + WEIGHT * count, base + STATE * count
    for i in range(count):
        r = packed[base + i]
        z = max(u - r, min(u + r, packed[states + i]))
        packed[states + i] = z
        v += packed[weights + i] * z
    return v


@numba.njit(cache=True)
def play_value(packed: Array, base: int, count: int) -> float:
    """Weighted sum of the states as they are."""
    v = 0.0
    weights, states = base + WEIGHT * count, base + STATE * count
    for i in range(count):
        v += packed[weights + i] * packed[states + i]
    return v


@numba.njit(cache=True)
def play_solve(packed: Array, base: int, count: int, v: float) -> float:
    """Find the input u at which the plays would sum to `v`, moving no state (derived here).

    The sum is a strictly increasing, piecewise linear function of u. From consistent states the plays join the
    movement one after the other, play i at z_i + r_i upwards and at z_i - r_i downwards, so one scan finds u.
    """
    weights, states = base + WEIGHT * count, base + STATE * count
    missing = v - play_value(packed, base, count)
    sign = 1.0 if missing >= 0.0 else -1.0
    missing *= sign
    position: float = packed[states]
    slope: float = packed[weights]
    for i in range(1, count):
        kink = packed[states + i] + sign * packed[base + i]
        rise = slope * (kink - position) * sign
        if missing <= rise:
            break
        missing -= rise
        position = kink
        slope += packed[weights + i]
    return position + sign * missing / slope


@numba.njit(cache=True)
def play_wider_step(packed: Array, base: int, count: int, u: float, factor: float, more: float) -> float:
    """`play_step` with thresholds above 0 multiplied by `factor` and widened by `more`.

    Source: Al Janaideh and Krejci (2013), IEEE/ASME Trans. Mechatronics 18(5), 1498-1507: rate-dependent thresholds.
    """
    v = 0.0
    weights, states = base + WEIGHT * count, base + STATE * count
    for i in range(count):
        r = packed[base + i]
        r = r * factor + more if r > 0.0 else 0.0
        z = max(u - r, min(u + r, packed[states + i]))
        packed[states + i] = z
        v += packed[weights + i] * z
    return v


@numba.njit(cache=True)
def play_wider_solve(packed: Array, base: int, count: int, v: float, factor: float, more: float) -> float:
    """Input u at which the plays with such thresholds would sum to `v`, moving no state.

    After a change of the thresholds the plays need not join in their order, so the scan of `play_solve` does not serve:
    Newton's steps on the rising, piecewise linear sum, kept between bounds that close in. Ends on the piece that holds
    the solution, hence exact.
    """
    weights, states = base + WEIGHT * count, base + STATE * count
    u: float = packed[states]
    low, high = -np.inf, np.inf
    for _ in range(MOST_NEWTON):
        total, slope = 0.0, 0.0
        for i in range(count):
            r = packed[base + i]
            r = r * factor + more if r > 0.0 else 0.0
            z = packed[states + i]
            if z < u - r:
                total += packed[weights + i] * (u - r)
                slope += packed[weights + i]
            elif z > u + r:
                total += packed[weights + i] * (u + r)
                slope += packed[weights + i]
            else:
                total += packed[weights + i] * z
                if r == 0.0:
                    slope += packed[weights + i]
        missing = v - total
        if missing > 0.0:
            low = u
        elif missing < 0.0:
            high = u
        else:
            return u
        trial = u + missing / slope if slope > 0.0 else np.nan
        if not low < trial < high:
            trial = 0.5 * (low + high)
        if trial == u or not np.isfinite(trial):
            return u
        u = trial
    return u


@numba.njit(cache=True)
def play_states_run(packed: Array, base: int, count: int, u: Array, states: Array) -> None:
    """Every play's state over the record `u`, shape (N,), into `states`, shape (N, count): the columns of (3.14)."""
    for k in range(u.size):
        play_step(packed, base, count, u[k])
        for i in range(count):
            states[k, i] = packed[base + STATE * count + i]


@numba.njit(cache=True)
def play_run(packed: Array, base: int, count: int, u: Array, factor: Array, offset: Array, v: Array) -> None:
    """Weighted sum of the plays over the record `u`, shape (N,), into `v`.

    Thresholds above 0 are multiplied by `factor` and widened by `offset`, each of shape (N,) or empty: rate-dependent
    plays (piezod/operators/README.md, "Thresholds that change with time").
    """
    weights, states = base + WEIGHT * count, base + STATE * count
    for k in range(u.size):
        wider = factor[k] if factor.size else 1.0
        more = offset[k] if offset.size else 0.0
        total = 0.0
        for i in range(count):
            r = packed[base + i]
            r = r * wider + more if r > 0.0 else 0.0
            z = max(u[k] - r, min(u[k] + r, packed[states + i]))
            packed[states + i] = z
            total += packed[weights + i] * z
        v[k] = total


def inverse_table(thresholds: Array, weights: Array) -> tuple[Array, Array]:
    """Thresholds and weights of the inverse superposition (3.28-3.32, 3.35); applied twice it gives back its input.

    Parameters
    ----------
    thresholds
        Strictly increasing from 0, shape (n + 1,).
    weights
        Same shape; every partial sum above 0.

    Returns
    -------
    thresholds, weights
        r'_i = sum_{j<=i} w_j (r_i - r_j) and w'_i = 1/W_i - 1/W_{i-1}, with W_i = sum_{j<=i} w_j.
    """
    slopes = np.cumsum(weights)
    inverse_weights = np.empty_like(slopes)
    inverse_weights[0] = 1.0 / slopes[0]
    inverse_weights[1:] = -weights[1:] / (slopes[1:] * slopes[:-1])
    inverse_thresholds = np.concatenate(([0.0], np.cumsum(slopes[:-1] * np.diff(thresholds))))
    return inverse_thresholds, inverse_weights


def inverse_states(weights: Array, states: Array) -> Array:
    """States of the inverse plays, from those of the direct ones: z'_i = W_i z_i + sum_{j>i} w_j z_j (3.34)."""
    products = weights * states
    tail = np.concatenate((np.cumsum(products[::-1])[::-1][1:], [0.0]))
    result: Array = np.cumsum(weights) * states + tail
    return result


def check_superposition(what: str, thresholds: Array, weights: Array, eps: float) -> None:
    """Refuse what has no inverse: unordered thresholds, or a loading curve whose slope falls below `eps`.

    Raises
    ------
    ModelError
        Names index, threshold and value.
    """
    if thresholds.ndim != 1 or thresholds.size == 0 or thresholds.shape != weights.shape:
        raise ModelError(
            f"{what}: {thresholds.size} thresholds and {weights.size} weights, must be as many, at least one"
        )
    if not (np.isfinite(thresholds).all() and np.isfinite(weights).all()):
        raise ModelError(f"{what}: thresholds and weights must be finite")
    if thresholds[0] != 0.0:
        raise ModelError(f"{what}: threshold 0 is {thresholds[0]:g}, must be 0 (the linear part)")
    unordered = np.flatnonzero(np.diff(thresholds) <= 0.0)
    if unordered.size:
        i = int(unordered[0]) + 1
        raise ModelError(
            f"{what}: threshold {i} is {thresholds[i]:g}, must be above {thresholds[i - 1]:g}, the one before"
        )
    slopes = np.cumsum(weights)
    folded = np.flatnonzero(slopes < eps * (1.0 - 1e-9))
    if folded.size:
        i = int(folded[0])
        raise ModelError(
            f"{what}: partial sum of weights 0..{i} is {slopes[i]:g}, must be at least eps, {eps:g}: "
            "the loading curve folds there and has no inverse; identify again with constraints"
        )


def check_states(thresholds: Array, states: Array) -> None:
    """Refuse states that no input can have produced: |z_i - z_{i-1}| <= r_i - r_{i-1} must hold.

    Raises
    ------
    ModelError
        Names index and values.
    """
    if states.shape != thresholds.shape or not np.isfinite(states).all():
        raise ModelError(f"play states: {states.size} values, must be {thresholds.size} finite ones")
    room = np.diff(thresholds)
    rounding = 1e-12 * (1.0 + float(np.abs(states).max()) + float(thresholds[-1]))
    impossible = np.flatnonzero(np.abs(np.diff(states)) > room + rounding)
    if impossible.size:
        i = int(impossible[0]) + 1
        raise ModelError(
            f"play states: state {i} is {states[i]:g}, {abs(states[i] - states[i - 1]):g} from state {i - 1}, "
            f"must be within {room[i - 1]:g}: no input leads there; start from a reset cycle"
        )
