"""Coarse converter: the step of its readings, and the force between the steps.

A reading limits the force to one step. When a reading changes to the next value, the force crosses the middle of both.
At this instant a coarse reading is nearly as accurate as a fine one, the more so the slower the force moves.
"""

from dataclasses import replace

import numpy as np

from piezod.arrays import Array
from piezod.estimation.recordings.series import Series

FINE = 6.0  # step over the noise below which the noise averages the rounding
REST = 20  # samples in a window in which only the noise may change the reading
EARLY_CROSSING = 2.0  # distance from the middle at which the noise makes a slow force cross it [noise rms]
LONGEST_RUN = 8  # longest run of equal readings in which the force is interpolated


def converter_step_N(readings: Array) -> float:
    """Step of the converter [N]; 0 if the readings show no step coarser than a millionth of their range."""
    values = np.unique(readings)
    if values.size < 3 or values.size > readings.size // 3:
        return 0.0
    steps = np.diff(values)
    smallest = float(np.percentile(steps, 20))
    if smallest < 1e-6 * float(np.ptp(readings)):
        return 0.0
    multiples = steps / smallest
    return smallest if np.mean(np.abs(multiples - np.rint(multiples)) < 0.05) > 0.95 else 0.0


def unrounded(series: Series) -> Series:
    """Series of a coarse converter with interpolated readings and a weight of each reading.

    The force is interpolated between the instants at which readings change. A reading within a run of r equal readings
    has the error step / (r sqrt(12)) and the noise. A long run only limits the force to the step. A reading that jumps
    over several steps stays unchanged.
    """
    step_N, size = series.lattice_N, series.time_s.size
    changes = np.flatnonzero(np.diff(series.reading_N))  # between k and k + 1
    if step_N == 0.0 or changes.size < 2:
        return series
    noise_N = _noise_N(series)
    if step_N < FINE * noise_N:
        return series
    moves = np.diff(series.reading_N)[changes]
    single = np.abs(moves) < 1.5 * step_N  # of several steps at once, the instants of crossing are unknown
    middles_N = np.where(single, 0.5 * (series.reading_N[changes] + series.reading_N[changes + 1]), np.nan)
    run = np.searchsorted(changes, np.arange(size))  # number of the run of each sample
    first, end = np.concatenate(([0], changes + 1)), np.concatenate((changes + 1, [size]))
    start_N, end_N = np.concatenate(([np.nan], middles_N))[run], np.concatenate((middles_N, [np.nan]))[run]
    lengths, place = (end - first)[run], np.arange(size) - first[run]
    fraction = (place + 0.5) / lengths
    at_change = ((place == 0) & ~np.isnan(start_N)) | ((place == lengths - 1) & ~np.isnan(end_N))
    short, crossing = lengths <= LONGEST_RUN, np.abs(end_N - start_N) > 0.0  # nan: not crossing
    known = at_change | (crossing & short)
    between_N = (1.0 - fraction) * start_N + fraction * end_N
    interpolated_N = np.where(np.isnan(start_N), end_N, np.where(np.isnan(end_N), start_N, between_N))
    corrected_N = np.where(known, interpolated_N, series.reading_N)
    noise_factor = np.where(short, 1.0, EARLY_CROSSING)
    error_N = np.hypot(noise_factor * noise_N, step_N / np.where(known, lengths, 1) / np.sqrt(12.0))
    error_N[~known] = step_N / np.sqrt(12.0)
    within_N = np.where(known | short, 0.0, 0.5 * step_N + EARLY_CROSSING * noise_N)
    unit_N = float(np.mean(error_N[series.counts & (within_N == 0.0)] ** -2.0)) ** -0.5
    rounding_N = series.reading_N - corrected_N
    return replace(series, noise_N=unit_N, rounding_N=rounding_N, trust=unit_N / error_N, within_N=within_N)


def _noise_N(series: Series) -> float:
    """Noise in front of the converter, from changes of the reading while the force rests [N].

    The mean difference of two readings of a resting force equals the mean difference of two values of the noise.
    """
    count = series.time_s.size // REST
    parts = series.reading_N[: count * REST].reshape(count, REST)
    complete = series.counts[: count * REST].reshape(count, REST).all(axis=1)
    rests = complete & (np.abs(parts[:, -1] - parts[:, 0]) < 1.5 * series.lattice_N)
    if not rests.any():
        return 0.0
    moves = np.diff(parts[rests], axis=1)
    differences_N = 0.0
    for window in moves:
        steps = window[window != 0.0]
        differences_N += float(np.sum(np.abs(steps[1:])[steps[1:] * steps[:-1] < 0.0]))
    return differences_N / moves.size * float(np.sqrt(np.pi)) / 2.0
