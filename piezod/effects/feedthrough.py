"""The drive couples into the load cell's signal in proportion to its slope.

Forward    F + y, rise y' + y = k du/dt, u the voltage at the stack; exact for a straight or held voltage
Inverse    subtract y from the reading
Signature  on triangles a square wave that jumps at the corners and is there with nothing mounted; look-alike
           electrical_lag has the same plateau and reaches it slowly
Seat       load cell
Valid      drives of several slopes; rise_s above half a sample
Source     H. W. Ott (1988), Noise Reduction Techniques in Electronic Systems, capacitive coupling; a term in proportion
           to u is a gain of the stack; piezod/effects/README.md, "Feedthrough"
"""

import math

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def coupling_step(y: float, change_V: float, keep: float, jump: float) -> float:
    """Advance by a sample in which the voltage changes; keep = exp(-T / rise), `jump` by `coefficients`."""
    return keep * y + jump * change_V


@numba.njit(cache=True, nogil=True)
def _run(u: Array, keep: float, jump: float) -> Array:
    out = np.empty(u.size)
    y = 0.0
    out[0] = y
    for k in range(1, u.size):
        y = coupling_step(y, u[k] - u[k - 1], keep, jump)
        out[k] = y
    return out


def coefficients(rise_s: float, dt_s: float, hold: float) -> tuple[float, float]:
    """How much of y is kept from sample to sample (1), and how much a change of the voltage adds to it [1/s].

    A straight voltage pulls y towards its slope all the time; a held one jumps once, which fades until it is read.
    """
    keep = math.exp(-dt_s / rise_s) if rise_s > 0.0 else 0.0
    if hold <= 0.0:
        return keep, (1.0 - keep) / dt_s
    return keep, math.exp(-min(hold, 1.0) * dt_s / rise_s) / rise_s if rise_s > 0.0 else 0.0


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Signal with what the drive adds, shape (N,) [N]."""
    keep, jump = coefficients(values.get("rise_s", 0.0), context.dt_s, context.hold.number)
    out: Array = signal + values["coefficient_N_s_per_V"] * _run(context.applied_V, keep, jump)
    return out


EFFECT = Effect(
    name="feedthrough",
    title="drive couples into the signal",
    seat=Seat.LOAD_CELL,
    form="additive",
    parameters=(
        Parameter("coefficient_N_s_per_V", "N s/V", -10.0, 10.0, starts=(0.005,)),
        Parameter("rise_s", "s", 1e-5, 0.1, starts=(5e-4,), logarithmic=True, nuisance=True),
    ),
    forward=forward,
    handling="corrected in the reading",
    docstring=__doc__,
    why="it is no force: driving against it would make one",
    separate_by="the same drive with the load cell taken off the stack",
)
