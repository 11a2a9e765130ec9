"""The inverse of a model with an unnamed law: its expected addition is subtracted from the reference, by iteration.

    F(k) = reference(k) - law(u(k), F(k)),   u(k) = plan(F(k))

The iteration contracts while the law changes less within a tick than the force; otherwise the law is not compensated.
Nor is a law with modes: behind a sampled mode the voltages that reach a reference may grow without end.
K. J. Astrom, P. Hagander, J. Sternby (1984), Zeros of sampled systems, Automatica 20(1).
"""

from collections.abc import Collection
from pathlib import Path

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.tick import SHARED
from piezod.model.chain.compiled_steps import CALLED
from piezod.model.chain.tick_chain import TickChain
from piezod.model.chain.tick_steps import Program, commit_chain, plan_chain
from piezod.model.parameters import Model
from piezod.model.unnamed_law import NAME, LawStep, advance_drivers, advance_law
from piezod.operators.compiled_cache import forget_outdated_steps

ITERATIONS = 3
LARGEST = 0.7  # of the force's slope; three iterations then leave a third of the law's change within a tick
ADDED, TARGET, PLANNED = range(3)


@numba.njit(cache=True)
def _plan(
    program: Program,
    chain: Array,
    state: Array,
    scratch: Array,
    settings: Array,
    axes: Array,
    keeps: Array,
    tables: Array,
    memo: Array,
    reference: float,
) -> float:
    target = reference - memo[ADDED]
    for _ in range(ITERATIONS):
        planned_V = plan_chain(program, chain, target)
        for k in range(state.size):
            scratch[k] = state[k]
        advance_drivers(scratch, settings, planned_V, target)
        target = reference - advance_law(scratch, settings, axes, keeps, tables)
    planned_V = plan_chain(program, chain, target)
    memo[TARGET], memo[PLANNED] = target, planned_V
    return planned_V


@numba.njit(cache=True)
def _commit(
    program: Program,
    chain: Array,
    state: Array,
    settings: Array,
    axes: Array,
    keeps: Array,
    tables: Array,
    memo: Array,
    voltage_V: float,
) -> None:
    commit_chain(program, chain, voltage_V)
    force = memo[TARGET] if voltage_V == memo[PLANNED] else chain[program[0, 0] + SHARED.force_N]
    advance_drivers(state, settings, voltage_V, force)
    memo[ADDED] = advance_law(state, settings, axes, keeps, tables)


class LawInverse:
    """Plan and commit with an unnamed law, for `ExtendedCompensator`; allocates nothing."""

    def __init__(self, law: LawStep, chain: TickChain) -> None:
        forget_outdated_steps(_plan.stats.cache_path, (*CALLED, Path(__file__).parent))
        self._chain = chain.program, chain.state
        self._state, self._tables = law.arrays[0], law.arrays[1:]
        self._scratch, self._memo = self._state.copy(), np.empty(3)
        self.reset()

    def reset(self) -> None:
        """Return to rest at the next tick."""
        self._state[:] = 0.0
        self._memo[ADDED], self._memo[TARGET], self._memo[PLANNED] = 0.0, 0.0, np.nan  # no voltage is planned yet

    @property
    def added_N(self) -> float:
        """Addition of the law to the force at the tick committed last [N]."""
        return float(self._memo[ADDED])

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reading of `reference` [N] at the end of the tick; changes no state."""
        return _plan(*self._chain, self._state, self._scratch, *self._tables, self._memo, reference)

    def commit(self, voltage_V: float) -> None:
        """Advance every state with the voltage `voltage_V` [V] that was written."""
        _commit(*self._chain, self._state, *self._tables, self._memo, voltage_V)


def law_inverse(model: Model, chain: TickChain, without: Collection[str] = ()) -> LawInverse | None:
    """Inverse with the unnamed law of a model; None without a law, with modes, or where its iteration may not contract.

    Parameters
    ----------
    without
        Names of effects that are deliberately not compensated.
    """
    if model.unnamed_law is None or model.unnamed_law.modes or NAME in without:
        return None
    law = LawStep(model.unnamed_law, chain.dt_s)
    over_command, over_reading = law.steepest(model.output.high - model.output.low)
    weights = model.hysteresis.plays.weights
    strokes = np.linspace(model.input.low, model.input.high, 200) * sum(weights)
    slope = weights[0] * float(np.min(np.diff(model.hysteresis.operator().output(strokes)) / np.diff(strokes)))
    return LawInverse(law, chain) if over_command / slope + over_reading < LARGEST else None
