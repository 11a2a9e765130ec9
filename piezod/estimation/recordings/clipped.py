"""Readings that are clipped at an end of the converter's range."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezod.estimation.recordings.series import Series
from piezod.recording.stretches import stretches_of

Array = NDArray[np.float64]

FEWEST = 3  # stretches at an extreme reading that make it a limit: a sensor hardly freezes there repeatedly


def clipped_stretches(
    series: Series, model_N: Array, stretches: Sequence[tuple[int, int]]
) -> dict[float, list[tuple[int, int]]]:
    """Clipped stretches (first, end) by their limit [N].

    A limit is the highest or the lowest reading with at least `FEWEST` stretches in which the model lies mostly beyond
    it. Then all runs of readings at the limit are clipped.

    `model_N`: expected readings, shape (N,) [N]; `stretches`: stretches (first, end) of equal readings.
    """
    readings = series.reading_N[series.counts]
    clipped: dict[float, list[tuple[int, int]]] = {}
    for limit_N, side in ((float(readings.max()), 1.0), (float(readings.min()), -1.0)):
        at_limit = [(first, end) for first, end in stretches if series.reading_N[first] == limit_N]
        if len(_beyond(at_limit, side * model_N, side * limit_N)) >= FEWEST:
            clipped[limit_N] = _beyond(stretches_of(series.reading_N == limit_N), side * model_N, side * limit_N)
    return clipped


def _beyond(stretches: Sequence[tuple[int, int]], model_N: Array, limit_N: float) -> list[tuple[int, int]]:
    """Stretches in which the model is beyond the limit for most of the time."""
    return [(first, end) for first, end in stretches if np.mean(model_N[first:end] > limit_N) > 0.5]


def clipped_note(series: Series, limit_N: float, stretches: Sequence[tuple[int, int]], unit: str) -> str:
    """Note about clipped stretches of a recording at a limit; `unit`: unit of the readings."""
    samples = sum(end - first for first, end in stretches)
    begin_s, end_s = (float(series.time_s[at]) + series.start_s for at in (stretches[0][0], stretches[-1][1] - 1))
    return (
        f"{series.name}: clipped at {limit_N:.6g} {unit}, {samples} samples in {len(stretches)} stretches from "
        f"{begin_s:.3g} to {end_s:.3g} s; they do not count: record with a larger range"
    )
