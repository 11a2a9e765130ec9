"""A coarse converter: readings lie on a lattice.

Forward    offset + step round((F - offset) / step)
Inverse    refused
Signature  few distinct values at equal distances, plateaus where dF/dt T < step; look-alike sensor_dropout stands still
           in one place only
Seat       acquisition
Valid      steps above the noise; below it noise dithers the lattice away
Source     Widrow, Kollar and Liu (1996), Statistical Theory of Quantization, doi:10.1109/19.492784;
           piezod/effects/README.md, "Quantisation"
"""

import math

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def lattice_step(force: float, step: float, offset: float) -> float:
    """Nearest point of the lattice, upwards from the middle [N]."""
    return offset + step * math.floor((force - offset) / step + 0.5)


@numba.njit(cache=True, nogil=True)
def _run(force: Array, step: float, offset: float) -> Array:
    out = np.empty(force.size)
    for k in range(force.size):
        out[k] = lattice_step(force[k], step, offset)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Reading on the lattice, shape (N,) [N]."""
    return _run(signal, values["step_N"], values.get("offset_N", 0.0))


EFFECT = Effect(
    name="quantisation",
    title="coarse converter",
    seat=Seat.ACQUISITION,
    form="memoryless",
    parameters=(
        Parameter("step_N", "N", 1e-4, 100.0, starts=(0.1, 1.0), logarithmic=True),
        Parameter("offset_N", "N", -100.0, 100.0, starts=(0.0,), nuisance=True),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why="what is lost within a step cannot be had back; a finer range, or averaging over noise wider than a step, can",
    separate_by="a slow ramp over some steps: the distinct values counted",
)
