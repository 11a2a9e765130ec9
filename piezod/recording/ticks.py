"""Consecutive rows of the ring log: each command with the readings that it caused.

The exchange of a tick writes a command, then reads the force that the command of the row before has caused. A sample
therefore joins the command of row k with the readings of row k + 1. A missed tick has no row. Where an exchange
failed, its readings are nan.
"""

import numpy as np
from numpy.typing import NDArray

GOOD = 0  # `result` of an exchange that did not fail


def pair_rows(
    rows: NDArray[np.void], before: NDArray[np.void] | None = None
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Pair each row of commands with the row after it, whose readings those commands caused.

    Parameters
    ----------
    rows
        Consecutive rows of the ring log, shape (N,), dtype `ROW_DTYPE`.
    before
        Last row of the part before these, shape (1,); None where there is no such part.

    Returns
    -------
    tuple
        Rows to take commands from and rows to take readings from, of equal shape (N - 1,), or (N,) with `before`.
    """
    joined = rows if before is None or not rows.size else np.concatenate((before, rows))
    return joined[:-1], joined[1:]
