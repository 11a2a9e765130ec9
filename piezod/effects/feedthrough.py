"""The drive couples into the load cell's signal in proportion to its slope.

Forward    F + y, rise y' + y = k du/dt, u the voltage at the stack; exact for a straight or held voltage
Inverse    subtract y from the reading
Signature  on triangles a square wave that jumps at the corners and is there with nothing mounted; look-alike
           electrical_lag has the same plateau and reaches it slowly
Seat       load cell
Valid      drives of several slopes; rise_s above half a sample
Source     THEORY 3 S (k1); its k0 is a gain and cannot be told from the stack's
"""

import math

import numba
import numpy as np

from piezod.effects.effect import STRAIGHT, Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def coupling_step(y: float, slope: float, keep: float) -> float:
    """Advance rise y' + y = slope by a sample of constant slope; keep = exp(-T / rise)."""
    return keep * y + (1.0 - keep) * slope


@numba.njit(cache=True, nogil=True)
def _run(u: Array, dt_s: float, keep: float) -> Array:
    out = np.empty(u.size)
    y = 0.0
    out[0] = y
    for k in range(1, u.size):
        y = coupling_step(y, (u[k] - u[k - 1]) / dt_s, keep)
        out[k] = y
    return out


@numba.njit(cache=True, nogil=True)
def _run_held(u: Array, keep: float, jump: float) -> Array:
    """A step of the voltage jumps by `jump` of itself in what is read after it, and fades by `keep` a sample."""
    out = np.empty(u.size)
    y = 0.0
    out[0] = y
    for k in range(1, u.size):
        y = keep * y + jump * (u[k] - u[k - 1])
        out[k] = y
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Signal with what the drive adds, shape (N,) [N]."""
    rise_s, dt_s = values.get("rise_s", 0.0), context.dt_s
    keep = math.exp(-dt_s / rise_s) if rise_s > 0.0 else 0.0
    if context.between > STRAIGHT:
        jump = math.exp(-min(context.between, 1.0) * dt_s / rise_s) / rise_s if rise_s > 0.0 else 0.0
        coupled = _run_held(context.applied_V, keep, jump)
    else:
        coupled = _run(context.applied_V, dt_s, keep)
    out: Array = signal + values["coefficient_N_s_per_V"] * coupled
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
