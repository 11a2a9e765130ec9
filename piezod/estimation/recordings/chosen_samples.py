"""Masks of the samples that the user chooses: outside of stretches, or at a value of a column."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezod.errors import UsageError
from piezod.recording import Recording


def outside(recording: Recording, stretches: Sequence[str]) -> NDArray[np.bool_]:
    """Mask of the samples outside the stretches `FROM:TO` [s], both ends included, shape (N,).

    Raises
    ------
    UsageError
        A stretch does not have this form.
    """
    result = np.ones(recording.time_s.size, bool)
    for stretch in stretches:
        first, _, last = stretch.partition(":")
        try:
            ends = float(first), float(last)
        except ValueError:
            raise UsageError(f"--leave-out is '{stretch}', must be FROM:TO in seconds, such as 12.5:14") from None
        if not ends[0] <= ends[1]:
            raise UsageError(f"--leave-out is '{stretch}': must begin before it ends")
        result &= (recording.time_s < ends[0]) | (recording.time_s > ends[1])
    return result


def where(recording: Recording, condition: str) -> NDArray[np.bool_]:
    """Mask of the samples at which `COLUMN=VALUE` holds, shape (N,).

    Raises
    ------
    UsageError
        The condition does not have this form.
    RecordingError
        The recording lacks the column.
    """
    column, _, value = condition.partition("=")
    try:
        number = float(value)
    except ValueError:
        raise UsageError(f"--where is '{condition}', must be COLUMN=NUMBER") from None
    result: NDArray[np.bool_] = recording.channel(column) == number
    return result
