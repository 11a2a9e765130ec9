"""The drive couples into the signal of the load cell, in proportion to the slope of the applied voltage.

Forward    F + y, rise y' + y = k du/dt, u the applied voltage. Exact for a straight and for a held voltage.
Inverse    On the reading: subtract y.
Signature  On triangles a square wave that jumps at the corners and exists without a mounted stack. Look-alike:
           electrical_lag reaches the same plateau slowly.
Location   Load cell.
Valid      Drives of several slopes; rise_s above half a sample.
Source     H. W. Ott (1988), Noise Reduction Techniques in Electronic Systems, Wiley, capacitive coupling. A term in
           proportion to u is a gain of the stack. piezod/effects/README.md, "Feedthrough".
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import SHARED, Memory, Tick, TickSetting


@numba.njit(cache=True, nogil=True)
def coupling_step(y: float, change_V: float, keep: float, jump: float) -> float:
    """State y after a sample in which the voltage changes by `change_V`.

    Parameters
    ----------
    y
        State before [V/s].
    change_V
        Change of the applied voltage [V].
    keep, jump
        From `coefficients`.
    """
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
    """Coefficients of `coupling_step`.

    Parameters
    ----------
    rise_s
        Time constant of the coupling [s], at least 0.
    dt_s
        Spacing of the samples [s].
    hold
        Number of a `Hold`. A straight voltage has a slope during the whole sample. A held voltage jumps once, and the
        response decays until the reading.

    Returns
    -------
    keep, jump
        Part of y that remains after one sample [1], and increase of y per change of the voltage [1/s].
    """
    keep = math.exp(-dt_s / rise_s) if rise_s > 0.0 else 0.0
    if hold <= 0.0:
        return keep, (1.0 - keep) / dt_s
    return keep, math.exp(-min(hold, 1.0) * dt_s / rise_s) / rise_s if rise_s > 0.0 else 0.0


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Signal with the coupled drive, shape (N,) [N].

    `signal` is the signal of the load cell [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    keep, jump = coefficients(values.get("rise_s", 0.0), context.dt_s, (context.drive_hold or context.hold).number)
    out: Array = signal + values["coefficient_N_s_per_V"] * _run(context.applied_V, keep, jump)
    return out


N_S_PER_V, KEEP, JUMP, COUPLED = range(4)  # memory: constants; state of `coupling_step`


def _memory(values: Values, setting: TickSetting) -> Array:
    keep, jump = coefficients(values.get("rise_s", 0.0), setting.dt_s, setting.drive_hold.number)
    return np.array([values["coefficient_N_s_per_V"], keep, jump, 0.0])


def _advance(own: Memory, shared: Memory, force_N: float) -> float:
    moved_V = shared[SHARED.now_V] - shared[SHARED.before_V]
    own[COUPLED] = coupling_step(own[COUPLED], moved_V, own[KEEP], own[JUMP])
    return force_N + own[N_S_PER_V] * own[COUPLED]


def _settle(own: Memory, _shared: Memory, force_N: float) -> float:
    own[COUPLED] = 0.0
    return force_N


EFFECT = Effect(
    name="feedthrough",
    title="drive couples into the signal",
    location=Location.LOAD_CELL,
    form="additive",
    parameters=(
        Parameter("coefficient_N_s_per_V", "N s/V", -10.0, 10.0, Search((0.005,))),
        Parameter("rise_s", "s", 1e-5, 0.1, Search((5e-4,), logarithmic=True, nuisance=True)),
    ),
    forward=forward,
    handling="corrected in the reading",
    tick=Tick(_memory, _advance, settle=_settle),
    docstring=__doc__,
    why="it is no force: driving against it would make one",
    separate_by="the same drive with the load cell taken off the stack",
    narrow=True,
    checks=Checks(values={"rise_s": 0.05}),
)
