"""The modified Prandtl-Ishlinskii operator and its inverse.

- `PrandtlIshlinskii`, the forward operator: plays first, dead zones second (3.8).
- `ImplicitInverse`, the inverse that drives the bench. It keeps the plays of the forward operator and solves for the
  input of each sample. It plans an input without moving a state. The input that was applied then moves the states.
  The inverse therefore stays exact after a limit.

Each owns one packed array: [play count, dead-zone count, offset | r, w, z of the plays | r, w of the dead zones].
Theory: piezod/operators/README.md, "Forward chain" and "Implicit inverse: plan and commit".
"""

import numba
import numpy as np
from numpy.typing import ArrayLike

from piezod.arrays import Array
from piezod.operators.compiled_cache import forget_outdated_steps
from piezod.operators.dead_zone import check_dead_zone, dead_zone_run, dead_zone_step, inverse_dead_zone
from piezod.operators.play import (
    check_states,
    check_superposition,
    play_run,
    play_solve,
    play_step,
    play_value,
)

EPS = 0.01  # smallest partial sum of weights that the inverse accepts (thesis, chapter 6)
HEADER = 3  # numbers in front of the thresholds of the plays


@numba.njit(cache=True)
def forward_step(packed: Array, u: float) -> float:
    """Advance by one sample: y = S[H[u]] + offset.

    Parameters
    ----------
    packed
        Packed array of a `PrandtlIshlinskii`; its states change.
    u
        New input [unit of a play threshold].
    """
    plays, zones = int(packed[0]), int(packed[1])
    v = play_step(packed, HEADER, plays, u)
    y: float = dead_zone_step(packed, HEADER + 3 * plays, zones, v) + packed[2]
    return y


@numba.njit(cache=True)
def forward_run(packed: Array, u: Array, y: Array) -> None:
    """Write `forward_step` over the record `u`, shape (N,), into `y`, shape (N,).

    Parameters
    ----------
    packed
        As in `forward_step`.
    u
        Input record, shape (N,).
    y
        Buffer for the outputs, shape (N,).
    """
    for k in range(u.size):
        y[k] = forward_step(packed, u[k])


@numba.njit(cache=True)
def plan_step(packed: Array, y: float) -> float:
    """Input at which the output would be `y`; moves no state.

    Parameters
    ----------
    packed
        Packed array of an `ImplicitInverse`.
    y
        Output to reach [unit of the operator's output].
    """
    plays, zones = int(packed[0]), int(packed[1])
    v = dead_zone_step(packed, HEADER + 3 * plays, zones, y - packed[2])
    return play_solve(packed, HEADER, plays, v)


@numba.njit(cache=True)
def commit_step(packed: Array, u: float) -> None:
    """Move the states of the plays with the input that was applied.

    Parameters
    ----------
    packed
        Packed array of a `PrandtlIshlinskii` or an `ImplicitInverse`; its states change.
    u
        Applied input [unit of a play threshold].
    """
    play_step(packed, HEADER, int(packed[0]), u)


@numba.njit(cache=True)
def output_of(packed: Array, zones: Array) -> float:
    """Output at the present states of the plays; moves no state.

    Parameters
    ----------
    packed
        Packed array of an `ImplicitInverse`.
    zones
        Thresholds, then weights, of the direct dead zones, shape (2 n,).
    """
    v = play_value(packed, HEADER, int(packed[0]))
    y: float = dead_zone_step(zones, 0, zones.size // 2, v) + packed[2]
    return y


@numba.njit(cache=True)
def plan_commit_run(packed: Array, y: Array, low: float, high: float, u: Array) -> None:
    """Plan, clamp to [low, high] and commit over the record `y`, shape (N,); the inputs go into `u`, shape (N,).

    Parameters
    ----------
    packed
        Packed array of an `ImplicitInverse`; its states change.
    y
        Outputs to reach, shape (N,).
    low, high
        Limits of the input; low is at most high.
    u
        Buffer for the inputs, shape (N,).
    """
    for k in range(y.size):
        u[k] = min(max(plan_step(packed, y[k]), low), high)
        commit_step(packed, u[k])


def _pack(plays: tuple[Array, Array], states: Array, zones: tuple[Array, Array], offset: float) -> Array:
    header = np.array([plays[0].size, zones[0].size, offset])
    return np.concatenate((header, *plays, states, *zones))


class PrandtlIshlinskii:
    """The modified Prandtl-Ishlinskii operator y = S[H[u]] + offset.

    Parameters
    ----------
    play_thresholds, play_weights
        r_i [unit of u] and w_i [1], shape (n + 1,), r strictly increasing from 0.
    dead_zone_thresholds, dead_zone_weights
        r_j [unit of u] and w_j [unit of y per unit of u]; shape (m + 1,) from 0 upwards (unipolar) or both sides of 0.
    offset
        Added to the output [unit of y].
    eps
        Smallest accepted partial sum of the play weights [1]. For the dead zones: a fraction of their steepest slope.

    Raises
    ------
    ModelError
        The operator has no inverse; the message names index and value.

    Notes
    -----
    A new operator is de-energised: all states are 0.
    Source: Kuhnen (2003), Modeling, Identification and Compensation of Complex Hysteretic Nonlinearities: A Modified
    Prandtl-Ishlinskii Approach, European Journal of Control 9(4); piezod/operators/README.md, equations 3.1 to 3.36.
    """

    def __init__(
        self,
        play_thresholds: ArrayLike,
        play_weights: ArrayLike,
        dead_zone_thresholds: ArrayLike = (0.0,),
        dead_zone_weights: ArrayLike = (1.0,),
        *,
        offset: float = 0.0,
        eps: float = EPS,
    ) -> None:
        forget_outdated_steps(forward_step.stats.cache_path)
        plays = np.array(play_thresholds, dtype=float), np.array(play_weights, dtype=float)
        zones = np.array(dead_zone_thresholds, dtype=float), np.array(dead_zone_weights, dtype=float)
        check_superposition("plays", *plays, eps)
        check_dead_zone(*zones, eps)
        self.offset = float(offset)
        self.packed = _pack(plays, np.zeros(plays[0].size), zones, self.offset)

    def stroke(self, u: ArrayLike, factor: Array | None = None, offset: Array | None = None) -> Array:
        """Weighted sum of the plays over the record `u`, shape (N,) [unit of u]; moves the states.

        Parameters
        ----------
        u
            Input, shape (N,).
        factor, offset
            The thresholds above 0 are r_i factor + offset, each of shape (N,) [1, unit of u]; None: 1 and 0.
        """
        inputs = np.ascontiguousarray(u, dtype=np.float64)
        nothing, v = np.empty(0), np.empty(inputs.size)
        count = int(self.packed[0])
        play_run(
            self.packed,
            HEADER,
            count,
            inputs,
            nothing if factor is None else factor,
            nothing if offset is None else offset,
            v,
        )
        return v

    def output(self, stroke: Array) -> Array:
        """Dead zones and offset of a stroke of shape (N,): the output, shape (N,)."""
        y = np.empty(stroke.size)
        dead_zone_run(self.packed, HEADER + 3 * int(self.packed[0]), int(self.packed[1]), stroke, y)
        result: Array = y + self.offset
        return result

    @property
    def plays(self) -> tuple[Array, Array]:
        """Thresholds and weights of the plays, as views."""
        n = int(self.packed[0])
        return self.packed[HEADER : HEADER + n], self.packed[HEADER + n : HEADER + 2 * n]

    @property
    def dead_zones(self) -> tuple[Array, Array]:
        """Thresholds and weights of the dead zones, as views."""
        start, m = HEADER + 3 * int(self.packed[0]), int(self.packed[1])
        return self.packed[start : start + m], self.packed[start + m : start + 2 * m]

    @property
    def states(self) -> Array:
        """Copy of the play states z_i."""
        n = int(self.packed[0])
        return self.packed[HEADER + 2 * n : HEADER + 3 * n].copy()

    def set_states(self, states: ArrayLike) -> None:
        """Set the play states, shape (n + 1,) [unit of u].

        Raises
        ------
        ModelError
            No input produces these states.
        """
        values = np.array(states, dtype=float)
        check_states(self.plays[0], values)
        n = int(self.packed[0])
        self.packed[HEADER + 2 * n : HEADER + 3 * n] = values

    def reset(self, peak: float) -> None:
        """Set the states after the drive 0, `peak`, 0 from the de-energised state.

        They are z_i = min(r_i, max(peak - r_i, 0)): piezod/operators/README.md, "Forward chain".
        """
        n = int(self.packed[0])
        self.packed[HEADER + 2 * n : HEADER + 3 * n] = 0.0
        for u in (0.0, peak, 0.0):
            commit_step(self.packed, u)

    def step(self, u: float) -> float:
        """Advance by one sample and return the output."""
        return float(forward_step(self.packed, u))

    def run(self, u: ArrayLike, out: Array | None = None) -> Array:
        """Advance over the record `u`, shape (N,), and return the outputs, shape (N,), in `out` where it is given."""
        inputs = np.ascontiguousarray(u, dtype=float)
        outputs = np.empty_like(inputs) if out is None else out
        forward_run(self.packed, inputs, outputs)
        return outputs


class ImplicitInverse:
    """Inverse of `operator` from its present states; `plan` solves for an input, `commit` moves the states."""

    def __init__(self, operator: PrandtlIshlinskii) -> None:
        zones = inverse_dead_zone(*operator.dead_zones)
        self.packed = _pack(operator.plays, operator.states, zones, operator.offset)

    def plan(self, y: float) -> float:
        """Input at which the output would be `y`; moves no state."""
        return float(plan_step(self.packed, y))

    def commit(self, u: float) -> None:
        """Move the states with the input that was applied."""
        commit_step(self.packed, u)

    def run(self, y: ArrayLike, low: float, high: float) -> Array:
        """Plan, clamp to [low, high] and commit over the record `y`, shape (N,); the inputs, shape (N,)."""
        outputs = np.ascontiguousarray(y, dtype=float)
        inputs = np.empty_like(outputs)
        plan_commit_run(self.packed, outputs, low, high, inputs)
        return inputs
