"""Correlation of residuals with the past of the command, by the age of that past."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.localisation import coordinates
from piezod.report.diagnosis.residual.residuals import Residuals

TIME_CONSTANTS = 14  # of the low-passes whose differences are the bands
SHORTEST_SAMPLES, LONGEST_SHARE = 8.0, 0.3  # range of the time constants: samples; share of the longest recording


@dataclass(frozen=True)
class Memory:
    """Correlation of the residuals with B bands of the command's past.

    Parameters
    ----------
    age_s
        Mean time constant of each band, shape (B,) [s].
    before, after
        Correlation for the given and the extended model, shape (B,) [1].
    """

    age_s: Array
    before: Array
    after: Array


def memory(recordings: Sequence[Residuals]) -> Memory:
    """Correlate residuals with the command's past, over all recordings together.

    Parameters
    ----------
    recordings
        Recordings with their residuals, at least one.
    """
    dt_s = min(recording.series.dt_s for recording in recordings)
    longest_s = max(recording.series.duration_s for recording in recordings)
    times_s = coordinates.times(dt_s, longest_s, TIME_CONSTANTS, SHORTEST_SAMPLES, LONGEST_SHARE)
    bands_count = TIME_CONSTANTS - 1
    products, powers, band_powers = np.zeros((2, bands_count)), np.zeros(2), np.zeros(bands_count)
    for recording in recordings:
        bands = _bands(recording, times_s)
        counts = recording.series.counts
        residuals = np.stack([_centred(recording.before, counts), _centred(recording.after, counts)])
        products += residuals @ bands
        band_powers += np.sum(bands**2, axis=0)
        powers += np.sum(residuals**2, axis=1)
    correlation = products / np.sqrt(np.maximum(np.outer(powers, band_powers), 1e-300))
    return Memory(np.sqrt(times_s[:-1] * times_s[1:]), correlation[0], correlation[1])


def _bands(recording: Residuals, times_s: Array) -> Array:
    """Differences of neighbouring low-passes of the command, without mean, 0 at rejected readings, shape (N, B)."""
    low_passes = coordinates.low_passed(recording.series.command_V, recording.series.dt_s, times_s)
    bands = low_passes[:, :-1] - low_passes[:, 1:]
    counts = recording.series.counts
    bands -= bands[counts].mean(axis=0)
    result: Array = np.where(counts[:, None], bands, 0.0)
    return result


def _centred(values: Array, counts: NDArray[np.bool_]) -> Array:
    result: Array = np.where(counts, values - values[counts].mean(), 0.0)
    return result
