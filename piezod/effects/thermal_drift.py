"""Parts of different thermal expansion change the force with the temperature.

Forward    F + coefficient (T - T(0)), with T behind a first-order lag from the sensor to the mount.
Inverse    Subtract the same term from the reference, with the recorded temperature or its last value, bounded.
Signature  An offset that follows the recorded temperature, whatever is driven. Look-alikes: creep starts at a step,
           charge_leakage returns to the start value, gain_drift scales with the loop.
Location   Mechanics.
Valid      Records in which the temperature changes. They need the channel temperature_C.
Source     Derived here. 0.5 to 30 N/K follow from 5 to 50 N/um, 20 to 40 mm and 5 to 15 ppm/K;
           piezod/effects/README.md, "Thermal drift".
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Context, Effect, Location, Values, all_the_time
from piezod.effects.kernels import first_order_run
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Memory, Tick, TickSetting


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force with the thermal drift, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    temperature = context.temperature_C
    assert temperature is not None  # see `needs`
    lag_s = values.get("lag_s", 0.0)
    warmer = temperature - temperature[0]
    at_mount = first_order_run(warmer, lag_s, context.dt_s) if lag_s > 0.0 else warmer
    out: Array = signal + values["coefficient_N_per_K"] * at_mount
    return out


N_PER_K, GAIN, FIRST_C, NOW_C, DRIFT_N = range(5)  # memory: constants; first and smoothed temperature, drift
LARGEST_CHANGE_K = 50.0  # a larger change of the temperature is taken for a fault of its sensor


def _memory(values: Values, setting: TickSetting) -> Array:
    lag_s = values.get("lag_s", 0.0)
    gain = -math.expm1(-setting.dt_s / lag_s) if lag_s > 0.0 else 1.0
    return np.array([values["coefficient_N_per_K"], gain, math.nan, math.nan, 0.0])


def _measure(own: Memory, _shared: Memory, temperature_C: float) -> float:
    """Update the drift with a temperature; an invalid one is ignored."""
    if math.isnan(own[FIRST_C]) and math.isfinite(temperature_C):
        own[FIRST_C] = own[NOW_C] = temperature_C
    if abs(temperature_C - own[FIRST_C]) <= LARGEST_CHANGE_K:
        own[NOW_C] += own[GAIN] * (temperature_C - own[NOW_C])
        own[DRIFT_N] = own[N_PER_K] * (own[NOW_C] - own[FIRST_C])
    return temperature_C


def _advance(own: Memory, _shared: Memory, force_N: float) -> float:
    return force_N + own[DRIFT_N]


def _invert(own: Memory, _shared: Memory, force_N: float) -> float:
    return force_N - own[DRIFT_N]


def _settle(own: Memory, _shared: Memory, force_N: float) -> float:
    own[FIRST_C] = own[NOW_C] = math.nan
    own[DRIFT_N] = 0.0
    return force_N


EFFECT = Effect(
    name="thermal_drift",
    title="thermal drift",
    location=Location.MECHANICS,
    form="additive",
    parameters=(
        Parameter("coefficient_N_per_K", "N/K", -1e3, 1e3, Search((1.0,))),
        Parameter("lag_s", "s", 0.0, 300.0, Search((0.0, 30.0), nuisance=True)),
    ),
    forward=forward,
    handling="compensated",
    needs="temperature_C",
    tick=Tick(_memory, _advance, _invert, _settle, measure=_measure),
    docstring=__doc__,
    separate_by="a hold at zero voltage after a reset cycle while the room temperature changes by several kelvin",
    place=all_the_time,
)
