"""The packed array of the chain: the constants of a model and its states, one number each.

    [constants of `ChainConstants`, states of `ChainStates`, creep elements: keep, ramp, weight and state of each]

Compiled steps read the array by name: `chain[CONSTANT.gain]`, `chain[STATE.applied_V]`. The compiler takes these names
for fixed numbers. A structured NumPy array would cost about 100 ns more per call.
"""

import math
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from piezod.effects.creep import PLAYS, spectrum
from piezod.effects.kernels import first_order_coefficients
from piezod.effects.output_nonlinearity import rising
from piezod.effects.rate_dependent_hysteresis import DISTANCE, OFFSET_SHARE, TIME, USUAL_DISTANCE_V
from piezod.model.compensated import ActingEffects
from piezod.model.parameters import Model
from piezod.recording.hold import HELD_ONE_SAMPLE, STRAIGHT

Array = NDArray[np.float64]
Number = TypeVar("Number", int, float)

LONGEST_CREEP_S = 1e5  # longer time constants of a creep are not compensated


class ChainConstants(NamedTuple, Generic[Number]):
    """Constants of the chain: their values as floats, or their places in the packed array as integers."""

    clamp_limit_V: Number  # inf: no clamp
    clamp_knee_V: Number
    slew_V: Number  # largest change per tick; inf: no limit
    lag_s: Number  # 0: no lag
    lag_swell: Number
    rate_growth: Number  # 0: no dependence on the rate
    rate_kind: Number
    rate_reference_V_per_s: Number
    rate_way_V: Number
    rate_memory_s: Number  # 0: the rate is smoothed over rate_way_V
    rate_offset_V: Number
    dt_s: Number
    gain: Number
    law_square: Number
    law_cube: Number
    law_low: Number  # range in which the law rises, in parts of its span
    law_high: Number
    law_span_N: Number  # 0: no curved law
    gap_N: Number  # 0: no gap
    gap_softness_N: Number
    creep_drive_per_V: Number  # 0: the plays drive the creep; else the voltage, scaled by this number


class ChainStates(NamedTuple, Generic[Number]):
    """States of the chain: their places in the packed array."""

    slewed_V: Number  # voltage behind clamp and slew limit
    applied_V: Number  # voltage at the stack
    rate_V_per_s: Number
    rested_s: Number
    start_V: Number
    start_stroke_V: Number  # output of the plays at the start
    creep_drive_V: Number
    thermal_N: Number  # thermal drift of the force


CONSTANT = ChainConstants(*range(len(ChainConstants._fields)))
STATE = ChainStates(*range(len(CONSTANT), len(CONSTANT) + len(ChainStates._fields)))
FIRST_ELEMENT = len(CONSTANT) + len(STATE)


def chain_array(model: Model, acting: ActingEffects, dt_s: float) -> Array:
    """Packed array of a chain with its states at 0, shape (FIRST_ELEMENT + 4 elements,).

    Parameters
    ----------
    model
        Identified or diagnosed model.
    acting
        Effects that act, with their parameter values.
    dt_s
        Tick period [s].

    Raises
    ------
    ModelError
        The creep follows the voltage and the model has no inverse.
    """
    keeps, ramps, weights = _creep_elements(acting, dt_s, model.seen_s or math.inf)
    constants = _constants(model, acting, dt_s)
    return np.concatenate((constants, np.zeros(len(STATE)), keeps, ramps, weights, np.zeros(weights.size)))


def _constants(model: Model, acting: ActingEffects, dt_s: float) -> ChainConstants[float]:
    clamp, slew = acting.get("voltage_clamp", {}), acting.get("slew_limit", {})
    lag, rate = acting.get("electrical_lag", {}), acting.get("rate_dependent_hysteresis", {})
    law, gap, creep = (acting.get(name, {}) for name in ("output_nonlinearity", "contact_gap", "creep"))
    cube = law.get("cubic", 0.0)
    square = law.get("curvature", 0.0) - cube
    low, high = rising(square, cube) if law else (0.0, 0.0)
    by_voltage = round(creep.get("driven_by", PLAYS)) != PLAYS
    return ChainConstants(
        clamp_limit_V=clamp.get("limit_V", math.inf),
        clamp_knee_V=clamp.get("knee_V", 0.0),
        slew_V=slew.get("limit_V_per_s", math.inf) * dt_s,
        lag_s=lag.get("time_constant_s", 0.0),
        lag_swell=lag.get("swell", 0.0),
        rate_growth=rate.get("growth", 0.0),
        rate_kind=float(round(rate.get("kind", 0.0))),
        rate_reference_V_per_s=rate.get("reference_V_per_s", 1.0),
        rate_way_V=rate.get("rate_way_V", USUAL_DISTANCE_V),
        rate_memory_s=rate["rate_memory_s"] if rate.get("rate_over", DISTANCE) == TIME else 0.0,
        rate_offset_V=OFFSET_SHARE * (model.input.high - model.input.low),
        dt_s=dt_s,
        gain=1.0 + acting.get("gain_drift", {}).get("relative_change", 0.0),
        law_square=square,
        law_cube=cube,
        law_low=low,
        law_high=high,
        law_span_N=model.output.high - model.output.low if law else 0.0,
        gap_N=gap.get("gap_N", 0.0),
        gap_softness_N=gap.get("softness_N", 0.0),
        creep_drive_per_V=model.hysteresis.stroke_per_V if by_voltage else 0.0,
    )


def _creep_elements(acting: ActingEffects, dt_s: float, seen_s: float) -> tuple[Array, Array, Array]:
    """Keep, ramp and weight of every creep element, each of shape (elements,).

    Behind a lag or a slew limit the voltage runs straight through a tick; otherwise it is held.
    """
    creep = acting.get("creep")
    if creep is None:
        return np.empty(0), np.empty(0), np.empty(0)
    to_s = min(creep["to_s"], LONGEST_CREEP_S)
    tau_s, weights = spectrum(creep["from_s"], to_s, creep.get("slope", 0.0), seen_s)
    hold = STRAIGHT if "electrical_lag" in acting or "slew_limit" in acting else HELD_ONE_SAMPLE
    keep, ramp = np.array([first_order_coefficients(element_s, dt_s, hold.number) for element_s in tau_s]).T
    return keep, ramp, creep["per_decade"] * weights
