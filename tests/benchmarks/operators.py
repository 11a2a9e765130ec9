"""The timed operators in both sizes, and their input record."""

import ctypes
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.excitation import triangle_ramp
from piezod.operators import PrandtlIshlinskii

Array = NDArray[np.float64]

SIZES = ((10, 4), (32, 8))  # plays and dead zones beside the linear part
PEAK_V = 140.0


def make_operator(plays: int, zones: int) -> PrandtlIshlinskii:
    """A stack of 0 to 140 V and about 300 N with so many plays and dead zones, after a reset cycle."""
    operator = PrandtlIshlinskii(
        np.linspace(0.0, 0.5 * PEAK_V, plays + 1),
        np.concatenate(([1.0], np.full(plays, 0.8 / plays))),
        np.linspace(0.0, PEAK_V, zones + 1),
        np.concatenate(([1.2], np.full(zones, 0.6 / zones))),
    )
    operator.reset(PEAK_V)
    return operator


def triangles_V(size: int, period: int = 10_000) -> Array:
    """Triangles over the whole range, one in `period` samples: a tenth of a hertz at a kilohertz."""
    return PEAK_V * triangle_ramp(np.arange(size) / period)


class CChain:
    """`chain.c` as a shared object; `run(name, ...)` is `name` over a record."""

    def __init__(self, path: Path) -> None:
        self._library = ctypes.CDLL(str(path))

    def run(self, name: str, packed: Array, inputs: Array, outputs: Array) -> None:
        """One pass."""
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (packed, inputs, outputs))
        getattr(self._library, name)(*pointers, ctypes.c_ssize_t(inputs.size))
