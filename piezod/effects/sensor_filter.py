"""The amplifier of the load cell has a low-pass.

Forward    Order 1: tau y' + y = F, tau = 1 / (2 pi f_c). Order 2: y'' + 2 zeta w y' + w^2 y = w^2 F, w = 2 pi f_c / r.
           r^2 = m + sqrt(m^2 + 1), m = 1 - 2 zeta^2; zeta 0.71 is Butterworth, 0.87 Bessel.
           Exact for a straight and for a held force.
Inverse    On the reading: F = y + tau y', or F = y + 2 zeta / w y' + y'' / w^2 for order 2.
Signature  Rounded and late corners, noise that falls above f_c. Look-alikes: electrical_lag leaves the noise white,
           transport_delay keeps corners, resonance overshoots.
Location   Load cell.
Valid      0.1 mHz to 5 kHz, from a few periods per record to a third of the sampling rate. A higher one is
           indistinguishable from a delay.
Source     Derived here. r follows from the definition of the cutoff, |H(f_c)|^2 = 1/2;
           piezod/effects/README.md, "Sensor filter".
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import LATE, Checks, Context, Effect, Location, Values
from piezod.effects.kernels import (
    first_order_coefficients,
    first_order_run,
    first_order_step,
    second_order,
    second_order_memory,
    second_order_settle,
    second_order_step,
)
from piezod.effects.parameter import Driven, Parameter, Search
from piezod.effects.tick import Memory, Tick, TickSetting

BUTTERWORTH = math.sqrt(0.5)
SLOWEST = 0.001  # of the sampling rate: slowest cutoff of a recording with rare samples; else 0.1 Hz


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Filtered signal, shape (N,) [N].

    `signal` is the signal of the load cell [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    cutoff = values["cutoff_Hz"]
    if round(values.get("order", 1.0)) == 1:
        return first_order_run(signal, 1.0 / (2.0 * math.pi * cutoff), context.dt_s, context.hold.number)
    return second_order(signal, *mode(values), context.dt_s, context.hold.number)


def mode(values: Values) -> tuple[float, float]:
    """Natural frequency [Hz] and damping ratio [1] of a filter of order 2.

    Parameters
    ----------
    values
        "cutoff_Hz" and, if present, "damping_ratio" of the effect.
    """
    damping_ratio = values.get("damping_ratio", BUTTERWORTH)
    part = 1.0 - 2.0 * damping_ratio**2
    return values["cutoff_Hz"] / math.sqrt(part + math.hypot(part, 1.0)), damping_ratio


ORDER, KEEP, RAMP, INPUT_N, OUTPUT_N, SECOND = range(6)  # memory; then that of a filter of order 2


def _memory(values: Values, setting: TickSetting) -> Array:
    hold = setting.hold.number
    keep, ramp = first_order_coefficients(0.5 / math.pi / values["cutoff_Hz"], setting.dt_s, hold)
    first = np.array([max(1.0, round(values.get("order", 1.0))), keep, ramp, 0.0, 0.0])
    return np.concatenate((first, second_order_memory(*mode(values), setting.dt_s, hold)))


def _advance(own: Memory, _shared: Memory, force_N: float) -> float:
    if own[ORDER] == 2.0:
        return second_order_step(own, SECOND, force_N)
    own[OUTPUT_N] = first_order_step(own[OUTPUT_N], own[INPUT_N], force_N, own[KEEP], own[RAMP])
    own[INPUT_N] = force_N
    return own[OUTPUT_N]


def _settle(own: Memory, _shared: Memory, force_N: float) -> float:
    own[INPUT_N] = own[OUTPUT_N] = force_N
    return second_order_settle(own, SECOND, force_N)


def _starts_Hz(driven: Driven) -> tuple[float, float, float]:
    """Cutoffs from a hundredth of the sampling rate, at most 5 Hz, to a third."""
    low_Hz, high_Hz = min(5.0, 0.01 / driven.dt_s), 0.3 / driven.dt_s
    return low_Hz, math.sqrt(low_Hz * high_Hz), high_Hz


EFFECT = Effect(
    name="sensor_filter",
    title="low-pass of the load cell",
    location=Location.LOAD_CELL,
    form="linear",
    parameters=(
        Parameter(
            "cutoff_Hz",
            "Hz",
            1e-4,
            5000.0,
            Search((5.0, 30.0, 150.0), starts_for=_starts_Hz, logarithmic=True),
            shown_by=lambda driven: (min(0.1, SLOWEST / driven.dt_s), 5000.0),
        ),
        Parameter("order", "1", 1.0, 2.0, Search((1.0,), nuisance=True, choices=(1.0, 2.0))),
        Parameter(
            "damping_ratio", "1", 0.5, 1.2, Search((BUTTERWORTH,), nuisance=True, only_if=("order", 2.0)), optional=True
        ),
    ),
    forward=forward,
    handling="corrected in the reading",
    smooths=True,
    tick=Tick(_memory, _advance, settle=_settle),
    docstring=__doc__,
    why="only the reading is late, not the true force: driving against it would overshoot",
    separate_by="a tap on the load cell, or its noise spectrum at rest: a filter in it shapes both",
    place=lambda values, record: ("frequency_Hz", values["cutoff_Hz"], record.nyquist_Hz),
    plausible=lambda values, record: 1.0 / (math.tau * values["cutoff_Hz"]) >= LATE * record.dt_s,
    checks=Checks(values={"cutoff_Hz": 3.0}),
)
