"""Readings that are clipped at the end of a converter's range: no frozen sensor, and no force."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series
from piezod.recording.stretches import stretches_of

Array = NDArray[np.float64]

FEWEST = 3
"""Stretches at one extreme reading from which it is a limit: a sensor hardly freezes there again and again."""


def clipped_stretches(
    series: Series, model_N: Array, stretches: Sequence[tuple[int, int]]
) -> dict[float, list[tuple[int, int]]]:
    """Those of the stretches of equal readings that a limit makes, by the limit [N].

    They stand at the highest or the lowest reading of the recording, at least `FEWEST` times, and the model is beyond
    that limit for most of the time. Then every run of readings at it counts, while the command rests too.

    Parameters
    ----------
    series
        A recording.
    model_N
        Readings that the model expects, shape (N,).
    stretches
        Stretches (first, end) in which the reading does not change.
    """
    readings = series.reading_N[series.counts]
    found: dict[float, list[tuple[int, int]]] = {}
    for limit_N, side in ((float(readings.max()), 1.0), (float(readings.min()), -1.0)):
        standing = [one for one in stretches if series.reading_N[one[0]] == limit_N]
        if len(_beyond(standing, side * model_N, side * limit_N)) >= FEWEST:
            found[limit_N] = _beyond(stretches_of(series.reading_N == limit_N), side * model_N, side * limit_N)
    return found


def _beyond(stretches: Sequence[tuple[int, int]], model_N: Array, limit_N: float) -> list[tuple[int, int]]:
    """Those in which the model is beyond a limit for most of the time."""
    return [(first, end) for first, end in stretches if np.mean(model_N[first:end] > limit_N) > 0.5]


def clipped_note(series: Series, limit_N: float, stretches: Sequence[tuple[int, int]], unit: str) -> str:
    """Sentence about readings at a limit.

    Parameters
    ----------
    series
        A recording.
    limit_N
        The limit [unit].
    stretches
        Where the reading stands there.
    unit
        Unit of the readings.
    """
    samples = sum(end - first for first, end in stretches)
    begin_s, end_s = (float(series.time_s[at]) + series.start_s for at in (stretches[0][0], stretches[-1][1] - 1))
    return (
        f"{series.name}: clipped at {limit_N:.6g} {unit}, {samples} samples in {len(stretches)} stretches from "
        f"{begin_s:.3g} to {end_s:.3g} s; they do not count: record with a larger range"
    )
