"""Readings that are clipped at an end of the converter's range."""

from collections.abc import Sequence

import numpy as np

from piezod.arrays import Array
from piezod.estimation.recordings.series import Series
from piezod.recording.stretches import stretches_of

FEWEST = 3  # stretches at an extreme reading that make it a limit: a sensor hardly freezes there repeatedly
# largest of nine in ten steps of the reading, times this, is a jump: after a freeze the reading jumps to where it
# would be, a limit is entered and left by a usual step
JUMP = 2.0


def clipped_stretches(
    series: Series, model_N: Array, stretches: Sequence[tuple[int, int]]
) -> dict[float, list[tuple[int, int]]]:
    """Clipped stretches (first, end) by their limit [N].

    A limit is the highest or the lowest reading. At least `FEWEST` stretches are there in which the model lies mostly
    beyond it, or the reading enters and leaves one without a jump. Then all runs of readings at the limit in which the
    model lies beyond it are clipped.

    `model_N`: expected readings, shape (N,) [N]; `stretches`: stretches (first, end) of equal readings.
    """
    readings = series.reading_N[series.counts]
    clipped: dict[float, list[tuple[int, int]]] = {}
    for limit_N, side in ((float(readings.max()), 1.0), (float(readings.min()), -1.0)):
        at_limit = [(first, end) for first, end in stretches if series.reading_N[first] == limit_N]
        continuous = [stretch for stretch in at_limit if not _jumps(series, *stretch)]
        if continuous or len(_beyond(at_limit, side * model_N, side * limit_N)) >= FEWEST:
            runs = stretches_of(series.reading_N == limit_N)
            clipped[limit_N] = sorted({*continuous, *_beyond(runs, side * model_N, side * limit_N)})
    return clipped


def _jumps(series: Series, first: int, end: int) -> bool:
    """Whether the reading jumps where the stretch begins or ends, or whether one of both was not recorded."""
    y = series.reading_N
    if first == 0 or end == y.size or not (series.counts[first - 1] and series.counts[end]):
        return True
    steps = np.abs(np.diff(y[series.counts]))
    usual_N = JUMP * float(np.quantile(steps[steps > 0.0], 0.9))
    return bool(max(abs(y[first] - y[first - 1]), abs(y[end] - y[end - 1])) > usual_N)


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
