"""The amplifier's current limit into the stack's capacitance: the voltage cannot change faster than it charges.

Forward    du'/dt = limit sign(u - u') until u' has caught up, then u' = u; exact for a straight or held voltage
Inverse    none beyond the limit: the reference is refused or shaped to the rate that is reachable
Signature  nothing below a rate, then ramps whose duration grows with the step; look-alike electrical_lag takes
           as long for every step
Seat       amplifier, in front of the hysteresis
Valid      one limit for both directions; one that no command exceeds cannot be seen
Source     Physik Instrumente (2005), Designing with Piezoelectric Transducers: |du/dt| <= I_max / C; the catching up
           inside an interval derived here; piezod/effects/README.md, "Slew limit"
"""

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def slew_step(y: float, before: float, now: float, most: float) -> float:
    """Advance by a sample while the command runs straight from `before` to `now` and y can move by `most`."""
    gap, rise = before - y, now - before
    sign = 1.0 if gap > 0.0 else -1.0
    closing = most - sign * rise
    if abs(gap) >= closing:  # not met within this sample
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
    """Voltage at the stack, shape (N,) [V]."""
    return _run(signal, values["limit_V_per_s"] * context.dt_s, context.hold.number)


EFFECT = Effect(
    name="slew_limit",
    title="current limit of the amplifier",
    seat=Seat.AMPLIFIER,
    form="other",
    parameters=(Parameter("limit_V_per_s", "V/s", 0.1, 1e6, starts=(20.0, 100.0, 500.0, 5000.0), logarithmic=True),),
    forward=forward,
    handling="compensated",
    smooths=True,
    docstring=__doc__,
    separate_by="steps of three sizes: a limit takes longer for a longer step, a lag does not",
)
