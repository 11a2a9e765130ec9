"""Weighted play (backlash) operators, stepped one sample at a time in a packed array.

The state z of a play of threshold r follows its input u when u has moved by r in either direction:

    z(k) = max(u(k) - r, min(u(k) + r, z(k-1)))                       (3.1)
    v(k) = sum_i w_i z_i(k),   0 = r_0 < r_1 < ... < r_n              (3.4)

The steps work on `packed[base : base + 3 * count]`: thresholds, weights and states, each `count` long. They allocate
no memory. Theory: piezod/operators/README.md, "Play" and "Weighted superposition".
"""

import numba
import numpy as np

from piezod.arrays import Array
from piezod.errors import ModelError

WEIGHT, STATE = 1, 2  # thirds of the block after the thresholds
MOST_NEWTON = 60  # steps: at most one for each linear piece, and some bisections


@numba.njit(cache=True)
def next_state(z: float, r: float, u: float) -> float:
    """State of a play of threshold `r` and state `z` after its input has moved to `u`: (3.1), for r at least 0.

    Parameters
    ----------
    z, r, u
        State, threshold of at least 0 and new input, all in one unit.
    """
    return min(max(z, u - r), u + r)


@numba.njit(cache=True)
def play_step(packed: Array, base: int, count: int, u: float) -> float:
    """Move every play to the input `u` and return the weighted sum of the states.

    Parameters
    ----------
    packed, base, count
        Array with thresholds, weights and states from index `base` on, `count` of each; the states change.
    u
        New input [unit of a threshold].
    """
    v = 0.0
    weights, states = base + WEIGHT * count, base + STATE * count
    for i in range(count):
        z = next_state(packed[states + i], packed[base + i], u)
        packed[states + i] = z
        v += packed[weights + i] * z
    return v


@numba.njit(cache=True)
def play_value(packed: Array, base: int, count: int) -> float:
    """Weighted sum of the present states; moves no state.

    Parameters
    ----------
    packed, base, count
        As for `play_step`.

    Returns
    -------
    sum_k w_k z_k, in the unit of the input.
    """
    v = 0.0
    weights, states = base + WEIGHT * count, base + STATE * count
    for i in range(count):
        v += packed[weights + i] * packed[states + i]
    return v


@numba.njit(cache=True)
def play_solve(packed: Array, base: int, count: int, v: float) -> float:
    """Input at which the weighted sum of the states would be `v`; moves no state (derived here).

    The sum is a strictly increasing, piecewise linear function of u. From consistent states the plays start to move in
    the order of i: play i at z_i + r_i upwards, at z_i - r_i downwards. One scan over the plays therefore finds u.

    Parameters
    ----------
    packed, base, count
        As in `play_step`; threshold 0 is 0 and every partial sum of the weights is above 0.
    v
        Weighted sum to reach [unit of u times a weight].
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
    """`play_step` with the thresholds r_i factor + more, where r_i is above 0.

    Source: Al Janaideh and Krejci (2013), Inverse Rate-Dependent Prandtl-Ishlinskii Model for Feedforward Compensation
    of Hysteresis in a Piezomicropositioning Actuator, IEEE/ASME Transactions on Mechatronics 18(5), 1498-1507.

    Parameters
    ----------
    packed, base, count, u
        As in `play_step`.
    factor, more
        Factor [1], above 0, and offset [unit of u], at least 0.
    """
    v = 0.0
    weights, states = base + WEIGHT * count, base + STATE * count
    for i in range(count):
        r = packed[base + i]
        r = r * factor + more if r > 0.0 else 0.0
        z = next_state(packed[states + i], r, u)
        packed[states + i] = z
        v += packed[weights + i] * z
    return v


@numba.njit(cache=True)
def play_wider_solve(packed: Array, base: int, count: int, v: float, factor: float, more: float) -> float:
    """`play_solve` with the thresholds of `play_wider_step`; moves no state (derived here).

    After a change of the thresholds the plays need not start to move in the order of i. Newton steps on the increasing,
    piecewise linear sum replace the scan, inside a bracket that shrinks. They end on the linear piece that holds the
    solution, so the result is exact.

    Parameters
    ----------
    packed, base, count, v, factor, more
        As in `play_solve` and `play_wider_step`.
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
    """Write the states over the record `u`, shape (N,), into `states`, shape (N, count): the columns of (3.14).

    Parameters
    ----------
    packed, base, count
        As in `play_step`.
    u, states
        Input record, shape (N,) [unit of a threshold]; buffer for the states, shape (N, count).
    """
    for k in range(u.size):
        play_step(packed, base, count, u[k])
        for i in range(count):
            states[k, i] = packed[base + STATE * count + i]


@numba.njit(cache=True)
def play_run(packed: Array, base: int, count: int, u: Array, factor: Array, offset: Array, v: Array) -> None:
    """Write `play_wider_step` over the record `u` into `v`.

    Theory: piezod/operators/README.md, "Thresholds that change with time".

    Parameters
    ----------
    packed, base, count
        As in `play_step`.
    u, v
        Input record [unit of a threshold] and buffer for the weighted sums, shape (N,).
    factor, offset
        Factor [1] and offset [unit of u] of the thresholds, shape (N,); empty: 1 and 0.
    """
    for k in range(u.size):
        wider = factor[k] if factor.size else 1.0
        more = offset[k] if offset.size else 0.0
        v[k] = play_wider_step(packed, base, count, u[k], wider, more)


def inverse_table(thresholds: Array, weights: Array) -> tuple[Array, Array]:
    """Thresholds and weights of the inverse superposition (3.28 to 3.32, 3.35).

    The map is its own inverse: applied twice it returns its input.

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


def check_superposition(what: str, thresholds: Array, weights: Array, eps: float) -> None:
    """Refuse a superposition without an inverse: unordered thresholds, or a loading curve with a slope below `eps`.

    Parameters
    ----------
    what
        Name of the operators, for the message.
    thresholds, weights
        Shape (n + 1,).
    eps
        Smallest slope that is accepted, above 0 [unit of a weight].

    Raises
    ------
    ModelError
        Thresholds do not increase from 0, or a slope is below `eps`; the message names index and value.
    """
    if thresholds.ndim != 1 or thresholds.size == 0 or thresholds.shape != weights.shape:
        raise ModelError(
            f"{what}: {thresholds.size} thresholds and {weights.size} weights, must be equally many, at least one"
        )
    if not (np.isfinite(thresholds).all() and np.isfinite(weights).all()):
        raise ModelError(f"{what}: thresholds and weights must be finite")
    if thresholds[0] != 0.0:
        raise ModelError(f"{what}: threshold 0 is {thresholds[0]:g}, must be 0 (the linear part)")
    unordered = np.flatnonzero(np.diff(thresholds) <= 0.0)
    if unordered.size:
        i = int(unordered[0]) + 1
        raise ModelError(
            f"{what}: threshold {i} is {thresholds[i]:g}, must be above {thresholds[i - 1]:g}, threshold {i - 1}"
        )
    slopes = np.cumsum(weights)
    below = np.flatnonzero(slopes < eps * (1.0 - 1e-9))
    if below.size:
        i = int(below[0])
        raise ModelError(
            f"{what}: partial sum of weights 0..{i} is {slopes[i]:g}, must be at least eps, {eps:g}: "
            "the loading curve is not monotone there and has no inverse; identify again with constraints"
        )


def check_states(thresholds: Array, states: Array) -> None:
    """Refuse states that no input can produce: |z_i - z_{i-1}| <= r_i - r_{i-1} must hold (derived here).

    Parameters
    ----------
    thresholds, states
        Thresholds, increasing from 0, and states of the plays, shape (n + 1,), both in one unit.

    Raises
    ------
    ModelError
        The states are not consistent; the message names index and values.
    """
    if states.shape != thresholds.shape or not np.isfinite(states).all():
        raise ModelError(f"play states: {states.size} values, must be {thresholds.size} finite ones")
    most = np.diff(thresholds)
    rounding = 1e-12 * (1.0 + float(np.abs(states).max()) + float(thresholds[-1]))
    impossible = np.flatnonzero(np.abs(np.diff(states)) > most + rounding)
    if impossible.size:
        i = int(impossible[0]) + 1
        raise ModelError(
            f"play states: state {i} is {states[i]:g}, {abs(states[i] - states[i - 1]):g} from state {i - 1}, "
            f"must be within {most[i - 1]:g}: no input produces these states; start from a reset cycle"
        )
