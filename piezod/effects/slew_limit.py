"""The maximum current of the amplifier limits the rate at which it charges the capacitance of the stack.

Forward    du'/dt = limit sign(u - u') until u' = u, then u' = u. Exact for a straight and for a held voltage.
Inverse    None beyond the limit. The states advance with the limited voltage; the reference must be slower.
Signature  Nothing below a rate, then ramps whose duration is proportional to the step. Look-alike: electrical_lag takes
           equally long for every step.
Location   Amplifier, in front of the hysteresis.
Valid      One limit for both directions. A limit that no command exceeds is not visible.
Source     Physik Instrumente (2005), Designing with Piezoelectric Transducers: |du/dt| <= I_max / C. The movement
           inside a sample: derived here; piezod/effects/README.md, "Slew limit".
"""

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Driven, Parameter, Search
from piezod.effects.tick import SHARED, Memory, Tick, TickSetting

STARTS = 10


@numba.njit(cache=True, nogil=True)
def slew_step(y: float, before: float, now: float, most: float) -> float:
    """Voltage at the stack one sample later.

    Parameters
    ----------
    y
        Voltage at the stack before [V].
    before, now
        The command runs straight from `before` to `now` [V].
    most
        Largest movement in this sample [V], at least 0.
    """
    gap, rise = before - y, now - before
    sign = 1.0 if gap > 0.0 else -1.0
    closing = most - sign * rise
    if abs(gap) >= closing:  # the voltage does not reach the command in this sample
        return y + sign * most
    left = 1.0 - abs(gap) / closing
    return before + rise * (1.0 - left) + min(most * left, max(-most * left, rise * left))


@numba.njit(cache=True, nogil=True)
def _run(x: Array, most: float, hold: float) -> Array:
    out = np.empty(x.size)
    y = x[0]
    out[0] = y
    late = min(hold, 1.0)
    for k in range(1, x.size):
        if hold > 0.0:
            y = slew_step(y, x[k - 1], x[k - 1], most * (1.0 - late)) if late < 1.0 else y
            y = slew_step(y, x[k], x[k], most * late)
        else:
            y = slew_step(y, x[k - 1], x[k], most)
        out[k] = y
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Voltage at the stack, shape (N,) [V].

    `signal` is the voltage [V]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return _run(signal, values["limit_V_per_s"] * context.dt_s, context.hold.number)


MOST_V, COMMAND_V = range(2)  # memory: largest change per tick; voltage behind the limit


def _memory(values: Values, setting: TickSetting) -> Array:
    return np.array([values["limit_V_per_s"] * setting.dt_s, 0.0])


def _advance(own: Memory, shared: Memory, voltage_V: float) -> float:
    """Voltage behind the limit; it runs straight through a tick in which the limit acts."""
    before_V = own[COMMAND_V]
    slewed_V = slew_step(before_V, voltage_V, voltage_V, own[MOST_V]) if voltage_V != before_V else voltage_V
    if slewed_V != voltage_V:
        shared[SHARED.runs_straight] = 1.0
    own[COMMAND_V] = slewed_V
    return slewed_V


def _settle(own: Memory, _shared: Memory, voltage_V: float) -> float:
    own[COMMAND_V] = voltage_V
    return voltage_V


def _starts(driven: Driven) -> tuple[float, ...]:
    """Limits from below the usual rate to near the highest one [V/s]."""
    usual = driven.usual_V_per_s
    return tuple(np.geomspace(0.3 * usual, 0.8 * max(driven.fastest_V_per_s, usual), STARTS).tolist())


EFFECT = Effect(
    name="slew_limit",
    title="current limit of the amplifier",
    location=Location.AMPLIFIER,
    form="other",
    parameters=(
        Parameter(
            "limit_V_per_s",
            "V/s",
            0.1,
            1e6,
            Search((20.0,), _starts, logarithmic=True),
            shown_by=lambda driven: (0.1 * driven.slow_V_per_s, driven.fastest_V_per_s),
        ),
    ),
    forward=forward,
    handling="compensated",
    smooths=True,
    tick=Tick(_memory, _advance, settle=_settle),
    docstring=__doc__,
    separate_by="steps of three sizes: a limit takes longer for a longer step, a lag does not",
    place=lambda values, record: ("rate_V_per_s", values["limit_V_per_s"], record.fastest_V_per_s),
    checks=Checks(values={"limit_V_per_s": 150.0}),
)
