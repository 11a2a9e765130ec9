"""The modified Prandtl-Ishlinskii operator and its inverse.

Forward: plays, then dead zones (3.8). Inverse: dead zones first, plays second (3.9). Two inverses are at hand:

- `AnalyticInverse` steps the inverse tables (3.28-3.36). Exact as long as what it returns is what is applied.
- `ImplicitInverse` keeps the plays of the forward operator and solves for the input sample by sample. It plans without
  moving a state and is then told what was really applied, so it stays exact when a limit bites. This is the one that
  drives.

All of them own one packed array: [play count, dead-zone count, offset | r, w, z of the plays | r, w of the dead zones].
"""

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.operators.compiled_cache import forget_outdated_steps
from piezod.operators.dead_zone import check_dead_zone, dead_zone_run, dead_zone_step, inverse_dead_zone
from piezod.operators.play import (
    check_states,
    check_superposition,
    inverse_states,
    inverse_table,
    play_run,
    play_solve,
    play_step,
)

Array = NDArray[np.float64]

EPS = 0.01  # smallest partial sum of weights that is inverted (thesis, chapter 6)
HEADER = 3


@numba.njit(cache=True)
def forward_step(packed: Array, u: float) -> float:
    """Advance by one sample: y = S[H[u]] + offset."""
    plays, zones = int(packed[0]), int(packed[1])
    v = play_step(packed, HEADER, plays, u)
    y: float = dead_zone_step(packed, HEADER + 3 * plays, zones, v) + packed[2]
    return y


@numba.njit(cache=True)
def forward_run(packed: Array, u: Array, y: Array) -> None:
    """`forward_step` over a record."""
    for k in range(u.size):
        y[k] = forward_step(packed, u[k])


@numba.njit(cache=True)
def analytic_inverse_step(packed: Array, y: float) -> float:
    """Advance the inverse tables by one sample: u = H'[S'[y - offset]]."""
    plays, zones = int(packed[0]), int(packed[1])
    v = dead_zone_step(packed, HEADER + 3 * plays, zones, y - packed[2])
    return play_step(packed, HEADER, plays, v)


@numba.njit(cache=True)
def plan_step(packed: Array, y: float) -> float:
    """Input that would bring the output to `y`; moves no state."""
    plays, zones = int(packed[0]), int(packed[1])
    v = dead_zone_step(packed, HEADER + 3 * plays, zones, y - packed[2])
    return play_solve(packed, HEADER, plays, v)


@numba.njit(cache=True)
def commit_step(packed: Array, u: float) -> None:
    """Move the plays with the input that was really applied."""
    play_step(packed, HEADER, int(packed[0]), u)


@numba.njit(cache=True)
def plan_commit_run(packed: Array, y: Array, low: float, high: float, u: Array) -> None:
    """Plan, clamp to [low, high] and commit over a record: what the tick does, for simulation."""
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
        Smallest partial sum of weights accepted, of the dead zones as a fraction of their steepest slope.

    Raises
    ------
    ModelError
        The operator has no inverse; index and value are named.

    Notes
    -----
    Source: Kuhnen's modified Prandtl-Ishlinskii operator as in the thesis' eqs 3.1-3.36. Starts de-energised (all
    states 0).
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
        """What the plays give over a record, shape (N,), with thresholds widened where that is asked for."""
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
        """What the dead zones and the offset make of it, shape (N,)."""
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
        """Start from `states`, shape (n + 1,).

        Raises
        ------
        ModelError
            No input leads to these states.
        """
        values = np.array(states, dtype=float)
        check_states(self.plays[0], values)
        n = int(self.packed[0])
        self.packed[HEADER + 2 * n : HEADER + 3 * n] = values

    def reset(self, peak: float) -> None:
        """Start from the states that a drive 0 -> `peak` -> 0 of the de-energised stack leaves behind.

        z_i = min(r_i, max(peak - r_i, 0)), derived here: piezod/operators/README.md, "Forward chain".
        """
        n = int(self.packed[0])
        self.packed[HEADER + 2 * n : HEADER + 3 * n] = 0.0
        for u in (0.0, peak, 0.0):
            commit_step(self.packed, u)

    def step(self, u: float) -> float:
        """Advance by one sample and return the output."""
        return float(forward_step(self.packed, u))

    def run(self, u: ArrayLike, out: Array | None = None) -> Array:
        """Advance over the record `u`, shape (N,); returns the outputs, written into `out` when given."""
        inputs = np.ascontiguousarray(u, dtype=float)
        outputs = np.empty_like(inputs) if out is None else out
        forward_run(self.packed, inputs, outputs)
        return outputs


class AnalyticInverse:
    """The inverse tables of `operator`, starting from its present states (3.28-3.36)."""

    def __init__(self, operator: PrandtlIshlinskii) -> None:
        plays = inverse_table(*operator.plays)
        states = inverse_states(operator.plays[1], operator.states)
        self.packed = _pack(plays, states, inverse_dead_zone(*operator.dead_zones), operator.offset)

    def step(self, y: float) -> float:
        """Advance by one sample and return the input that leads to output `y`."""
        return float(analytic_inverse_step(self.packed, y))


class ImplicitInverse:
    """The sample-wise inverse of `operator` with plan and commit, starting from its present states."""

    def __init__(self, operator: PrandtlIshlinskii) -> None:
        zones = inverse_dead_zone(*operator.dead_zones)
        self.packed = _pack(operator.plays, operator.states, zones, operator.offset)

    def plan(self, y: float) -> float:
        """Input that would bring the output to `y`; moves no state."""
        return float(plan_step(self.packed, y))

    def commit(self, u: float) -> None:
        """Move the states with the input that was really applied."""
        commit_step(self.packed, u)

    def run(self, y: ArrayLike, low: float, high: float) -> Array:
        """Plan, clamp to [low, high] and commit over the record `y`, shape (N,); returns the inputs."""
        outputs = np.ascontiguousarray(y, dtype=float)
        inputs = np.empty_like(outputs)
        plan_commit_run(self.packed, outputs, low, high, inputs)
        return inputs
