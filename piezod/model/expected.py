"""The reading that a model expects, and the force corrected for the load cell.

`ExpectedReading` runs the forward chain beside the bench, with the voltages that were written. The effects of the load
cell follow it; the compensator ignores them.

    force       plays, creep, gain -> force law -> curved law -> gap -> temperature -> resonance
    expected    force -> leakage -> low-pass -> coupling of the drive -> hum -> delay
    corrected   reading + force - expected

The correction takes the influence of the load cell from the model and everything else from the reading. It amplifies no
noise, as the inverse of a low-pass would, and integrates no error, as the inverse of a leakage would. While the reading
is frozen, the last difference stays. The result is for display and comparison; the interlocks check the raw reading.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.effects import EFFECTS
from piezod.effects.feedthrough import coupling_step
from piezod.effects.kernels import first_order_step
from piezod.model.chain_array import STATE
from piezod.model.compensated import acting_effects
from piezod.model.extended_compensator import ExtendedCompensator
from piezod.model.inverse_chain import commit_chain_step, force_of
from piezod.model.load_cell import CELL, CELL_STATE, LOW_PASS, RESONANCE, filter_matrices, hum_waves, load_cell_array
from piezod.model.parameters import Model
from piezod.model.unnamed_law import LawStep

Array = NDArray[np.float64]

FROZEN = 3.0  # [samples]; so many equal readings are a frozen reading
HUM_TIME_CONSTANT_S = 1.0  # of the estimates of amplitude and phase of the hum


@numba.njit(cache=True)
def _second_order(cell: Array, matrices: Array, y: int, before: float, now: float) -> float:
    """Advance the states at `y` and `y + 1` by a row of `filter_matrices`; the result is the first."""
    y0, y1 = cell[y], cell[y + 1]
    cell[y] = matrices[0] * y0 + matrices[1] * y1 + matrices[4] * before + matrices[6] * now
    cell[y + 1] = matrices[2] * y0 + matrices[3] * y1 + matrices[5] * before + matrices[7] * now
    result: float = cell[y]
    return result


@numba.njit(cache=True)
def _load_cell(cell: Array, matrices: Array, history: Array, before: float, force: float, moved_V: float) -> float:
    """Reading of the load cell without hum, after its delay [N]; `moved_V` is the change of the stack's voltage [V]."""
    signal = force
    if cell[CELL.leak_keep] > 0.0:
        leaked = cell[CELL_STATE.leaked_N]
        leaked = first_order_step(leaked, before, force, cell[CELL.leak_keep], cell[CELL.leak_ramp])
        cell[CELL_STATE.leaked_N] = leaked
        signal = force - (leaked - cell[CELL_STATE.start_N])
    earlier, cell[CELL_STATE.signal_N] = cell[CELL_STATE.signal_N], signal
    if cell[CELL.low_pass_order] == 1.0:
        passed = cell[CELL_STATE.passed_N]
        signal = first_order_step(passed, earlier, signal, cell[CELL.low_pass_keep], cell[CELL.low_pass_ramp])
        cell[CELL_STATE.passed_N] = signal
    elif cell[CELL.low_pass_order] == 2.0:
        signal = _second_order(cell, matrices[LOW_PASS], CELL_STATE.passed_N, earlier, signal)
    if cell[CELL.coupling_N_s_per_V] != 0.0:
        coupled = cell[CELL_STATE.coupled_V_per_s]
        coupled = coupling_step(coupled, moved_V, cell[CELL.coupling_keep], cell[CELL.coupling_jump])
        cell[CELL_STATE.coupled_V_per_s] = coupled
        signal += cell[CELL.coupling_N_s_per_V] * coupled
    tick, size = int(cell[CELL_STATE.tick]), history.size
    history[tick % size] = signal
    cell[CELL_STATE.tick] = tick + 1.0
    whole = int(cell[CELL.delay_ticks])
    part = cell[CELL.delay_ticks] - whole
    return float((1.0 - part) * history[(tick - whole) % size] + part * history[(tick - whole - 1) % size])


@numba.njit(cache=True)
def _hum(waves: Array, tick: float, turn: float, gain: float, difference_N: float) -> float:
    """Hum at a tick as estimated so far [N]; then update the estimate.

    Each row of `waves` is one harmonic: number, cosine [N], sine [N].
    """
    total = 0.0
    for h in range(waves.shape[0]):
        angle = waves[h, 0] * turn * tick
        total += waves[h, 1] * math.cos(angle) + waves[h, 2] * math.sin(angle)
    left = difference_N - total
    if abs(left) < math.inf:
        for h in range(waves.shape[0]):
            angle = waves[h, 0] * turn * tick
            waves[h, 1] += 2.0 * gain * left * math.cos(angle)
            waves[h, 2] += 2.0 * gain * left * math.sin(angle)
    return total


@numba.njit(cache=True)
def _start(cell: Array, history: Array, force: float) -> None:
    """Set the states to rest at a force [N]."""
    cell[CELL_STATE.force_N] = cell[CELL_STATE.driving_force_N] = cell[CELL_STATE.start_N] = force
    cell[CELL_STATE.leaked_N] = cell[CELL_STATE.signal_N] = cell[CELL_STATE.passed_N] = force
    history[:] = force


@numba.njit(cache=True)
def _run(
    packed: Array,
    chain: Array,
    zones: Array,
    cell: Array,
    matrices: Array,
    history: Array,
    waves: Array,
    turn: float,
    gain: float,
    voltage_V: Array,
    reading_N: Array,
    expected_N: Array,
    corrected_N: Array,
) -> None:
    """Advance by one tick per voltage; each reading belongs to the end of its tick."""
    if cell[CELL_STATE.tick] == 0.0:
        _start(cell, history, force_of(packed, chain, zones))
    for k in range(voltage_V.size):
        before_V, before = chain[STATE.applied_V], cell[CELL_STATE.force_N]
        commit_chain_step(packed, chain, voltage_V[k])
        force, driving = force_of(packed, chain, zones), cell[CELL_STATE.driving_force_N]
        cell[CELL_STATE.driving_force_N] = force
        if cell[CELL.resonates] > 0.0:
            force = _second_order(cell, matrices[RESONANCE], CELL_STATE.force_N, driving, force)
        cell[CELL_STATE.force_N] = force
        read = _load_cell(cell, matrices, history, before, force, chain[STATE.applied_V] - before_V)
        difference = reading_N[k] - read
        if waves.shape[0] > 0:
            hum = _hum(waves, cell[CELL_STATE.tick], turn, gain, difference)
            read += hum
            difference -= hum
        equal = reading_N[k] == cell[CELL_STATE.last_reading_N]
        cell[CELL_STATE.repeats] = cell[CELL_STATE.repeats] + 1.0 if equal else 0.0
        cell[CELL_STATE.last_reading_N] = reading_N[k]
        if cell[CELL_STATE.repeats] + 1.0 < FROZEN and abs(difference) < math.inf:
            cell[CELL_STATE.difference_N] = difference
        expected_N[k] = read
        corrected_N[k] = force + cell[CELL_STATE.difference_N]


class ExpectedReading:
    """Model that runs beside the bench.

    Parameters
    ----------
    model
        Model with its effects. Effects without an inverse are left out; their influence is in the difference between
        reading and expected reading.
    dt_s
        Tick period [s].

    Raises
    ------
    ModelError
        The model's operator has no inverse.
    """

    def __init__(self, model: Model, dt_s: float) -> None:
        acting = acting_effects(model)
        refused = [name for name in acting if EFFECTS[name].handling == "refused"]
        self._chain = ExtendedCompensator(model, dt_s, refused)
        thresholds, weights = model.hysteresis.operator().dead_zones
        self._zones = np.concatenate((thresholds, weights))
        # The hum of any recording counts: it is present in every drive, with another phase.
        hum = next((effect.parameters for effect in model.effects if effect.name == "mains_hum"), {})
        self._cell = load_cell_array(model, acting, dt_s, self._chain.delay_s)
        self._matrices, self._waves = filter_matrices(acting, dt_s), hum_waves(hum)
        self._history = np.zeros(math.ceil(self._cell[CELL.delay_ticks]) + 2)
        self._turn = 2.0 * math.pi * hum.get("frequency_Hz", 0.0) * dt_s
        self._gain = dt_s / HUM_TIME_CONSTANT_S
        self._law = None if model.unnamed_law is None else LawStep(model.unnamed_law, dt_s)

    def reset(self) -> None:
        """Return to the model's start state at rest; the estimate of the hum stays."""
        self._chain.reset()
        if self._law is not None:
            self._law.reset()
        self._cell[len(CELL) :] = 0.0
        self._cell[CELL_STATE.last_reading_N] = math.nan

    def run(self, voltage_V: Array, reading_N: Array, temperature_C: float = math.nan) -> tuple[Array, Array]:
        """Expected readings and corrected forces, each of shape (N,) [N].

        Parameters
        ----------
        voltage_V
            Written voltages, one a tick, shape (N,) [V].
        reading_N
            Readings at the end of each tick, shape (N,) [N]; nan without a reading.
        temperature_C
            Last temperature read [degC]. It changes slowly, so one value serves all ticks.
        """
        self._chain.update_temperature(temperature_C)
        expected, corrected = np.empty(voltage_V.size), np.empty(voltage_V.size)
        _run(
            *self._chain.arrays,
            self._zones,
            self._cell,
            self._matrices,
            self._history,
            self._waves,
            self._turn,
            self._gain,
            np.ascontiguousarray(voltage_V, dtype=np.float64),
            np.ascontiguousarray(reading_N, dtype=np.float64),
            expected,
            corrected,
        )
        if self._law is not None:
            expected += self._law.run(np.ascontiguousarray(voltage_V, dtype=np.float64), expected)
        return expected, corrected
