"""The learned correction of a looped table: a force for every tick of a repeat, exchanged between two repeats.

The control process reads it and another process writes it, through memory that both share:

    cells  = head | half 0 | half 1
    head   = half in use | half offered | repeat of the last exchange, or -1 | first tick of the first repeat

A writer fills the half that is not in use, then offers it. The reader takes it over at the begin of a repeat. It
blends it in over a few ticks, so that the voltage does not step. Neither waits for the other.
"""

from collections.abc import MutableSequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.arrays import Array

HEAD_CELLS = 4
_USED, _OFFERED, _EXCHANGED, _FIRST = range(HEAD_CELLS)
BLEND_PART = 20  # an exchange is blended in over this part of a repeat: short beside it, long beside a tick


def correction_cells(ticks: int) -> int:
    """Number of float64 values in the shared memory of a correction.

    Parameters
    ----------
    ticks
        Length of a repeat [ticks].
    """
    return HEAD_CELLS + 2 * ticks


class RepeatCorrection:
    """Correction of one looped table; both processes make one over the same cells.

    Parameters
    ----------
    cells
        Shared float64 values, `correction_cells(ticks)` of them, zero at first.

    Raises
    ------
    ValueError
        The cells have no room for a tick, or an odd number of values.
    """

    def __init__(self, cells: MutableSequence[float]) -> None:
        memory = memoryview(cells).cast("B").cast("d")  # type: ignore[arg-type]  # a ctypes array has a buffer
        if len(memory) < correction_cells(1) or len(memory) % 2:
            raise ValueError(f"a correction of {len(memory)} cells, must be an even number, at least 6")
        self.ticks = (len(memory) - HEAD_CELLS) // 2
        self._head = memory[:HEAD_CELLS]
        self._halves = (memory[HEAD_CELLS : HEAD_CELLS + self.ticks], memory[HEAD_CELLS + self.ticks :])
        self._used = int(self._head[_USED])
        self._repeat = -1
        self._blend_ticks = self.ticks // BLEND_PART
        self._blends = False

    def start(self, tick: int) -> None:
        """Let the first repeat begin at `tick`; the reader calls it."""
        self._head[_FIRST] = tick
        self._head[_EXCHANGED] = -1.0
        self._repeat, self._blends = -1, False

    def read(self, repeat: int, k: int) -> float:
        """Correction [N] of tick `k` of a repeat; the reader calls it once a tick, and allocates nothing.

        Parameters
        ----------
        repeat
            Number of the repeat, from 0.
        """
        if repeat != self._repeat:
            self._begin_repeat(repeat)
        value = self._halves[self._used][k]
        if self._blends and k < self._blend_ticks:
            value += (self._halves[1 - self._used][k] - value) * (1.0 - (k + 1) / self._blend_ticks)
        return value

    def _begin_repeat(self, repeat: int) -> None:
        self._repeat = repeat
        offered = int(self._head[_OFFERED])
        self._blends = offered != self._used
        if self._blends:
            self._used = offered
            self._head[_EXCHANGED] = repeat
            self._head[_USED] = offered

    @property
    def first_tick(self) -> int:
        """First tick of the first repeat."""
        return int(self._head[_FIRST])

    @property
    def waiting(self) -> bool:
        """Whether a correction is offered that the reader has not taken over."""
        return self._head[_OFFERED] != self._head[_USED]

    def offer(self, values_N: ArrayLike) -> None:
        """Offer a correction for the repeats to come; the writer calls it, and only while none is `waiting`.

        Parameters
        ----------
        values_N
            Correction of every tick of a repeat, shape (ticks,) [N].

        Raises
        ------
        ValueError
            The number of values differs, or one is not finite.
        """
        values = np.asarray(values_N, dtype=float)
        if values.shape != (self.ticks,) or not np.isfinite(values).all():
            raise ValueError(f"a correction of shape {values.shape}, must be ({self.ticks},) and finite")
        free = 1 - int(self._head[_USED])
        np.asarray(self._halves[free])[:] = values
        self._head[_OFFERED] = free

    def used(self, repeat: NDArray[np.int64], k: NDArray[np.int64]) -> Array:
        """Corrections [N] that past ticks had, at most two exchanges ago; the writer calls it.

        Parameters
        ----------
        repeat, k
            Repeats and ticks within them, each shape (N,).
        """
        half = int(self._head[_USED])
        now, before = (np.asarray(self._halves[one]) for one in (half, 1 - half))
        exchanged = int(self._head[_EXCHANGED])
        blended = 1.0 - (np.minimum(k + 1, self._blend_ticks)) / max(1, self._blend_ticks)
        of_before = np.where(repeat == exchanged, blended, (repeat < exchanged).astype(float))
        result: Array = now[k] + of_before * (before[k] - now[k])
        return result
