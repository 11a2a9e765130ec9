"""A coarse converter gives readings at multiples of one step.

Forward    offset + step round((F - offset) / step), halves upwards.
Inverse    Refused.
Signature  Few distinct values at equal distances, plateaus where |dF/dt| T < step. Look-alike: sensor_dropout is
           constant in one place only.
Location   Acquisition.
Valid      Steps above the noise. A smaller step acts as noise of variance step^2 / 12.
Source     B. Widrow, I. Kollar and M.-C. Liu (1996), Statistical Theory of Quantization, doi:10.1109/19.492784;
           piezod/effects/README.md, "Quantisation".
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search


@numba.njit(cache=True, nogil=True)
def nearest_multiple(force: float, step: float, offset: float) -> float:
    """Nearest value offset + n step, halves upwards [N].

    Parameters
    ----------
    force
        Value to round [N].
    step
        Distance of neighbouring values [N], above 0.
    offset
        One of the values [N].
    """
    return offset + step * math.floor((force - offset) / step + 0.5)


@numba.njit(cache=True, nogil=True)
def _run(force: Array, step: float, offset: float) -> Array:
    out = np.empty(force.size)
    for k in range(force.size):
        out[k] = nearest_multiple(force[k], step, offset)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Quantised reading, shape (N,) [N].

    `signal` is the reading [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return _run(signal, values["step_N"], values.get("offset_N", 0.0))


EFFECT = Effect(
    name="quantisation",
    title="coarse converter",
    location=Location.ACQUISITION,
    form="memoryless",
    parameters=(
        Parameter("step_N", "N", 1e-4, 100.0, Search((0.1, 1.0), logarithmic=True)),
        Parameter("offset_N", "N", -100.0, 100.0, Search((0.0,), nuisance=True)),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why="information inside a step is lost; use a finer range, or average over noise wider than a step",
    separate_by="a slow ramp over several steps, and a count of the distinct values",
    found_by="test",
    repeats=False,
    checks=Checks(constant="shifted"),
)
