"""Low-pass of the load cell's amplifier, behind the hysteresis.

Forward    order 1: tau y' + y = F, tau = 1 / (2 pi f_c); order 2: y'' + 2 zeta w y' + w^2 y = w^2 F, w = 2 pi f_c / r,
           r^2 = m + sqrt(m^2 + 1), m = 1 - 2 zeta^2 (zeta 0.71: Butterworth, 0.87: Bessel); exact as the lag
Inverse    F = y + tau y' (order 2: y + 2 zeta / w y' + y'' / w^2) on the reading
Signature  corners rounded and late, noise rolls off at f_c; look-alikes electrical_lag (noise stays white),
           transport_delay (corners stay sharp), resonance (overshoots)
Seat       load cell
Valid      f_c from a few 1/T to a third of the sampling rate; above, it cannot be told from a delay
Source     derived here: r from |H(f_c)|^2 = 1/2; piezod/effects/README.md, "Sensor filter"
"""

import math

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import first_order_run, second_order

BUTTERWORTH = math.sqrt(0.5)


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Filtered signal, shape (N,) [N]."""
    cutoff = values["cutoff_Hz"]
    if round(values.get("order", 1.0)) == 1:
        return first_order_run(signal, 1.0 / (2.0 * math.pi * cutoff), context.dt_s, context.hold.number)
    return second_order(signal, *mode(values), context.dt_s, context.hold.number)


def mode(values: Values) -> tuple[float, float]:
    """Natural frequency [Hz] and damping ratio [1] of the filter of second order."""
    damping_ratio = values.get("damping_ratio", BUTTERWORTH)
    part = 1.0 - 2.0 * damping_ratio**2
    return values["cutoff_Hz"] / math.sqrt(part + math.hypot(part, 1.0)), damping_ratio


EFFECT = Effect(
    name="sensor_filter",
    title="low-pass of the load cell",
    seat=Seat.LOAD_CELL,
    form="linear",
    parameters=(
        Parameter("cutoff_Hz", "Hz", 0.1, 5000.0, starts=(5.0, 30.0, 150.0), logarithmic=True),
        Parameter("order", "1", 1.0, 2.0, starts=(1.0,), nuisance=True, choices=(1.0, 2.0)),
        Parameter(
            "damping_ratio", "1", 0.5, 1.2, starts=(BUTTERWORTH,), nuisance=True, only_if=("order", 2.0), may_lack=True
        ),
    ),
    forward=forward,
    handling="corrected in the reading",
    smooths=True,
    docstring=__doc__,
    why="the true force is not late, only its reading is: driving against it would overshoot",
    separate_by="a tap on the load cell, or its noise spectrum at rest: a filter in it shapes both",
)
