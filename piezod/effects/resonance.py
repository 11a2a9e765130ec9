"""Stack and load form a lightly damped mode of second order.

Forward    y'' + 2 zeta w y' + w^2 y = w^2 F, w = 2 pi f. Exact for a straight and for a held force.
Inverse    F = y + 2 zeta / w y' + y'' / w^2, with two samples of preview, for smooth references.
Signature  Ringing at f after corners, a peak of the gain at f, and far below f an error in proportion to the
           acceleration. Look-alikes: vibration rings without corners, sensor_filter and electrical_lag do not ring.
Location   Mechanics.
Valid      2 to 5000 Hz and below half the sampling rate; zeta 0.001 to 1.
Source     H. J. M. T. S. Adriaens, W. L. de Koning and R. Banning (2000), Modeling Piezoelectric Actuators, IEEE/ASME
           Transactions on Mechatronics 5(4); piezod/effects/README.md, "Resonance".
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values, at_its_frequency
from piezod.effects.kernels import (
    second_order,
    second_order_matrices,
    second_order_memory,
    second_order_settle,
    second_order_step,
)
from piezod.effects.parameter import Parameter, Search, below_the_fastest_mode
from piezod.effects.tick import Memory, Preview, Tick, TickSetting

RINGS = 0.6  # damping ratio beyond which nothing is seen to ring: it is a lag


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force behind the mode, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return second_order(signal, values["frequency_Hz"], values["damping_ratio"], context.dt_s, context.hold.number)


HALF_SAMPLE_LEAD = np.array([-0.125, 0.625, 0.625, -0.125])  # filter with a flat gain to second order: derived here


def _memory(values: Values, setting: TickSetting) -> Array:
    return second_order_memory(values["frequency_Hz"], values["damping_ratio"], setting.dt_s, setting.hold.number)


def _advance(own: Memory, _shared: Memory, force_N: float) -> float:
    return second_order_step(own, 0, force_N)


def _settle(own: Memory, _shared: Memory, force_N: float) -> float:
    return second_order_settle(own, 0, force_N)


def invert(reference_N: Array, values: Values, dt_s: float) -> Array:
    """Force before the resonance, held for a tick each, that makes the readings follow a reference; shape (N,) [N].

    For a held force, y(k) + a1 y(k-1) + a2 y(k-2) = b1 F(k) + b2 F(k-1). The zero -b2 / b1 lies near -1, so its inverse
    would oscillate without end. The symmetrical filter `HALF_SAMPLE_LEAD` replaces it, accurate up to a quarter of the
    tick rate. Derived here.

    Parameters
    ----------
    reference_N
        Readings to reach, one a tick, shape (N,) [N]; constant before the first and after the last.
    values
        Frequency and damping ratio of the resonance.
    dt_s
        Tick period [s].
    """
    matrix, _, _ = second_order_matrices(values["frequency_Hz"], values["damping_ratio"], dt_s)
    trace, determinant = float(np.trace(matrix)), float(np.linalg.det(matrix))
    padded = np.pad(reference_N, 2, mode="edge")
    driven = padded[2:] - trace * padded[1:-1] + determinant * padded[:-2]
    force = np.convolve(np.pad(driven, (1, 2), mode="edge"), HALF_SAMPLE_LEAD, mode="valid")
    result: Array = force[: reference_N.size] / (1.0 - trace + determinant)
    return result


def _late_s(values: Values) -> float:
    """Delay of a reference far below the resonance [s]."""
    return values["damping_ratio"] / (math.pi * values["frequency_Hz"])


EFFECT = Effect(
    name="resonance",
    title="resonance of the mechanics",
    location=Location.MECHANICS,
    form="linear",
    parameters=(
        Parameter(
            "frequency_Hz",
            "Hz",
            2.0,
            5000.0,
            Search((20.0, 50.0, 120.0, 300.0), logarithmic=True, seen_in="spectrum"),
            shown_by=below_the_fastest_mode,
        ),
        Parameter("damping_ratio", "1", 1e-3, 1.0, Search((0.03, 0.3), logarithmic=True)),
    ),
    forward=forward,
    handling="compensated",
    smooths=True,
    tick=Tick(_memory, _advance, settle=_settle),
    preview=Preview(_late_s, ticks=2, ahead=invert),
    docstring=__doc__,
    separate_by="steps or triangles with abrupt corners, sampled at ten times the mode's frequency",
    place=at_its_frequency,
    plausible=lambda values, _record: values["damping_ratio"] <= RINGS,
    checks=Checks(values={"frequency_Hz": 8.0, "damping_ratio": 0.1}),
)
