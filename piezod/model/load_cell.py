"""The packed array of the resonance and the load cell: the constants of a model and its states, one number each.

    [constants of `LoadCellConstants`, states of `LoadCellStates`]

Compiled steps read the array by name: `cell[CELL.leak_keep]`, `cell[CELL_STATE.signal_N]`.
"""

import math
from collections.abc import Mapping
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from piezod.effects import EFFECTS
from piezod.effects.feedthrough import coefficients
from piezod.effects.kernels import first_order_coefficients, second_order_matrices
from piezod.effects.mains_hum import HARMONICS
from piezod.effects.sensor_filter import mode as low_pass_mode
from piezod.model.compensated import ActingEffects
from piezod.model.extended_compensator import ticks_late
from piezod.model.parameters import Model
from piezod.recording.hold import HELD_ONE_SAMPLE, STRAIGHT, Hold

Array = NDArray[np.float64]
Number = TypeVar("Number", int, float)

RESONANCE, LOW_PASS = 0, 1  # rows of `filter_matrices`


class LoadCellConstants(NamedTuple, Generic[Number]):
    """Constants of resonance and load cell: their values as floats, or their places in the array as integers."""

    resonates: Number  # 0: no resonance
    leak_keep: Number  # 0: no leakage
    leak_ramp: Number
    low_pass_order: Number  # 0: no low-pass
    low_pass_keep: Number
    low_pass_ramp: Number
    coupling_N_s_per_V: Number  # 0: no coupling of the drive
    coupling_keep: Number
    coupling_jump: Number
    delay_ticks: Number


class LoadCellStates(NamedTuple, Generic[Number]):
    """States of resonance and load cell: their places in the array."""

    force_N: Number  # force behind the resonance
    force_rate: Number  # second state of the resonance; follows the first
    driving_force_N: Number  # force before the resonance
    start_N: Number
    leaked_N: Number
    signal_N: Number  # signal before the low-pass
    passed_N: Number  # signal behind the low-pass
    passed_rate: Number  # second state of the low-pass; follows the first
    coupled_V_per_s: Number
    tick: Number
    last_reading_N: Number
    repeats: Number  # equal readings in a row, less one
    difference_N: Number  # reading less expected reading


CELL = LoadCellConstants(*range(len(LoadCellConstants._fields)))
CELL_STATE = LoadCellStates(*range(len(CELL), len(CELL) + len(LoadCellStates._fields)))


def load_cell_array(model: Model, acting: ActingEffects, dt_s: float, delay_s: float) -> Array:
    """Packed array with its states at 0, shape (len(CELL) + len(CELL_STATE),).

    Parameters
    ----------
    model
        Identified or diagnosed model.
    acting
        Effects that act, with their parameter values.
    dt_s
        Tick period [s].
    delay_s
        Time from the end of a tick to the reading that shows its force [s].
    """
    hold = _hold_behind_resonance(acting).number
    leak, low_pass, coupling = (acting.get(name, {}) for name in ("charge_leakage", "sensor_filter", "feedthrough"))
    none = (0.0, 0.0)
    leak_keep, leak_ramp = first_order_coefficients(leak["time_constant_s"], dt_s, hold) if leak else none
    low_pass_s = 0.5 / math.pi / low_pass["cutoff_Hz"] if low_pass else 0.0
    low_pass_keep, low_pass_ramp = first_order_coefficients(low_pass_s, dt_s, hold) if low_pass else none
    # As in the fit, which may take a held command for a straight one.
    straight = "electrical_lag" in acting or "slew_limit" in acting or model.hold.straight
    drive = STRAIGHT if straight else HELD_ONE_SAMPLE
    coupling_keep, coupling_jump = coefficients(coupling.get("rise_s", 0.0), dt_s, drive.number) if coupling else none
    lag_s = acting.get("electrical_lag", {}).get("time_constant_s", 0.0)
    constants: LoadCellConstants[float] = LoadCellConstants(
        resonates=float("resonance" in acting),
        leak_keep=leak_keep,
        leak_ramp=leak_ramp,
        low_pass_order=max(1.0, round(low_pass.get("order", 1.0))) if low_pass else 0.0,
        low_pass_keep=low_pass_keep,
        low_pass_ramp=low_pass_ramp,
        coupling_N_s_per_V=coupling.get("coefficient_N_s_per_V", 0.0),
        coupling_keep=coupling_keep,
        coupling_jump=coupling_jump,
        delay_ticks=ticks_late(delay_s, lag_s, dt_s),
    )
    cell = np.concatenate((constants, np.zeros(len(CELL_STATE))))
    cell[CELL_STATE.last_reading_N] = math.nan
    return cell


def filter_matrices(acting: ActingEffects, dt_s: float) -> Array:
    """Matrices of `second_order_matrices` for resonance and low-pass, shape (2, 8): M (4), `before` (2), `now` (2).

    Parameters
    ----------
    acting
        Effects that act, with their parameter values.
    dt_s
        Tick period [s].
    """
    rows = np.zeros((2, 8))
    if resonance := acting.get("resonance"):
        hold = _hold_before_resonance(acting)
        rows[RESONANCE] = _row(resonance["frequency_Hz"], resonance["damping_ratio"], dt_s, hold)
    if low_pass := acting.get("sensor_filter"):
        rows[LOW_PASS] = _row(*low_pass_mode(low_pass), dt_s, _hold_behind_resonance(acting))
    return rows


def hum_waves(hum: Mapping[str, float]) -> Array:
    """Harmonics of the mains hum in a model, shape (harmonics, 3): number, cosine [N], sine [N]; amplitudes are 0.

    Parameters
    ----------
    hum
        Parameter values of the effect; empty without hum.
    """
    if not hum:
        return np.zeros((0, 3))
    harmonics = [1, *(h for h in HARMONICS if hum.get(f"sine_{h}", 0.0) or hum.get(f"cosine_{h}", 0.0))]
    waves = np.zeros((len(harmonics), 3))
    waves[:, 0] = harmonics
    return waves


def _hold_before_resonance(acting: ActingEffects) -> Hold:
    """Hold of the force before the resonance; an effect that smooths makes it run straight."""
    smooth = any(EFFECTS[name].smooths for name in acting if EFFECTS[name].location < EFFECTS["resonance"].location)
    return STRAIGHT if smooth else HELD_ONE_SAMPLE


def _hold_behind_resonance(acting: ActingEffects) -> Hold:
    return STRAIGHT if "resonance" in acting else _hold_before_resonance(acting)


def _row(frequency_Hz: float, damping_ratio: float, dt_s: float, hold: Hold) -> Array:
    matrix, before, now = second_order_matrices(frequency_Hz, damping_ratio, dt_s, hold.number)
    return np.concatenate((matrix.ravel(), before, now))
