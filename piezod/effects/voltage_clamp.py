"""The output of the amplifier saturates: above its limit the voltage is constant.

Forward    u' = min(u, limit). For |u - limit| < knee: the parabola u - (u - limit + knee)^2 / (4 knee).
Inverse    None above the limit. The reachable force is reported, and the states advance with u'.
Signature  Flat tops at one voltage, at every rate. Look-alikes: output_nonlinearity still rises at the top, slew_limit
           needs a rate.
Location   Amplifier, in front of the hysteresis.
Valid      Limits inside the driven range. A limit that is never reached is not visible.
Source     Derived here, the parabola included; piezod/effects/README.md, "Voltage clamp".
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Memory, Tick, TickSetting


@numba.njit(cache=True, nogil=True)
def clamp_step(u: float, limit: float, knee: float) -> float:
    """Output voltage for the command `u` [V]. A knee of 0 V gives an abrupt limit.

    Parameters
    ----------
    u
        Command [V].
    limit
        Highest output voltage [V].
    knee
        Half width of the rounded transition around the limit [V], at least 0.
    """
    if abs(u - limit) < knee:
        return u - (u - limit + knee) ** 2 / (4.0 * knee)
    return min(u, limit)


@numba.njit(cache=True, nogil=True)
def _run(u: Array, limit: float, knee: float) -> Array:
    out = np.empty(u.size)
    for k in range(u.size):
        out[k] = clamp_step(u[k], limit, knee)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Voltage at the output of the amplifier, shape (N,) [V].

    `signal` is the voltage [V]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return _run(signal, values["limit_V"], values.get("knee_V", 0.0))


LIMIT_V, KNEE_V = range(2)  # memory


def _memory(values: Values, _setting: TickSetting) -> Array:
    return np.array([values["limit_V"], values.get("knee_V", 0.0)])


def _advance(own: Memory, _shared: Memory, voltage_V: float) -> float:
    return clamp_step(voltage_V, own[LIMIT_V], own[KNEE_V])


def _invert(own: Memory, _shared: Memory, voltage_V: float) -> float:
    """Command for a voltage; beyond the limit, the command that just reaches it."""
    inside = voltage_V - (own[LIMIT_V] - own[KNEE_V])
    if inside <= 0.0:
        return voltage_V
    if inside >= own[KNEE_V]:
        return own[LIMIT_V] + own[KNEE_V]
    return own[LIMIT_V] + own[KNEE_V] - 2.0 * math.sqrt(own[KNEE_V] * (own[KNEE_V] - inside))


PARTS = 0.5, 0.7, 0.85, 0.95  # of the highest command: starts of the limit

EFFECT = Effect(
    name="voltage_clamp",
    title="saturation of the amplifier",
    location=Location.AMPLIFIER,
    form="memoryless",
    parameters=(
        Parameter(
            "limit_V",
            "V",
            0.5,
            2000.0,
            Search((30.0,), lambda driven: tuple(part * driven.top_V for part in PARTS), logarithmic=True),
        ),
        Parameter(
            "knee_V",
            "V",
            1e-3,
            20.0,
            Search((0.3,), lambda driven: (0.003 * driven.top_V,), logarithmic=True, nuisance=True),
        ),
    ),
    forward=forward,
    handling="compensated",
    tick=Tick(_memory, _advance, _invert),
    docstring=__doc__,
    separate_by="two slow triangles with tops below and above the limit, with the amplifier's monitor output recorded",
    place=lambda values, record: ("voltage_V", values["limit_V"], record.highest_V),
    checks=Checks(values={"limit_V": 70.0, "knee_V": 5.0}, constant="shifted"),
)
