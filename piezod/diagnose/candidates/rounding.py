"""A coarse converter: the lattice on which its readings stand, and what they tell between its steps.

A reading says only that the force lies within a step. Where it changes to the next one, the force crosses the middle
between both at that instant: there a coarse reading is nearly as good as a fine one, and the finer the slower it moves.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series

Array = NDArray[np.float64]

FINE = 6.0  # noises a step, below which the noise itself reads between the steps
REST = 20  # samples within which the noise alone may change the reading
CARRIED = 2.0  # noises by which a force that hardly moves is carried over a middle
LONGEST_RUN = 8  # of equal readings, through which the force is taken to move evenly


def lattice_step_N(readings: Array) -> float:
    """Step of the readings' lattice, 0 where there is none that is coarser than a millionth of their range [N]."""
    values = np.unique(readings)
    if values.size < 3 or values.size > readings.size // 3:
        return 0.0
    steps = np.diff(values)
    smallest = float(np.percentile(steps, 20))
    if smallest < 1e-6 * float(np.ptp(readings)):
        return 0.0
    places = (values - values[0]) / smallest
    on_lattice = np.abs(places - np.rint(places)) < 0.02 * np.maximum(1.0, np.rint(places) * 1e-3)
    return (
        smallest
        if np.mean(np.abs(steps / smallest - np.rint(steps / smallest)) < 0.05) > 0.95 and on_lattice.size
        else 0.0
    )


def unrounded(series: Series) -> Series:
    """The same with the rounding of a coarse lattice undone and every reading trusted as far as it tells.

    The force is interpolated between the instants at which readings change. A reading within a run of r equal ones is
    off by step / (r sqrt(12)) and the noise; within long runs only a force beyond the step is told of. Where it leaps
    over several steps a reading is what it is.
    """
    step_N, size = series.lattice_N, series.time_s.size
    changes = np.flatnonzero(np.diff(series.reading_N))  # between k and k + 1
    if step_N == 0.0 or changes.size < 2:
        return series
    noise_N = _noise_N(series)
    if step_N < FINE * noise_N:
        return series
    moves = np.diff(series.reading_N)[changes]
    by_one = np.abs(moves) < 1.5 * step_N  # over several steps, and nothing tells when each of them was crossed
    middles_N = np.where(by_one, 0.5 * (series.reading_N[changes] + series.reading_N[changes + 1]), np.nan)
    run = np.searchsorted(changes, np.arange(size))  # number of the run that a sample is in
    first, end = np.concatenate(([0], changes + 1)), np.concatenate((changes + 1, [size]))
    came_N, goes_N = np.concatenate(([np.nan], middles_N))[run], np.concatenate((middles_N, [np.nan]))[run]
    lengths, place = (end - first)[run], np.arange(size) - first[run]
    passed = (place + 0.5) / lengths
    at_a_middle = ((place == 0) & ~np.isnan(came_N)) | ((place == lengths - 1) & ~np.isnan(goes_N))
    short, through = lengths <= LONGEST_RUN, np.abs(goes_N - came_N) > 0.0  # nan: not through
    between = at_a_middle | (through & short)
    ways_N = np.where(
        np.isnan(came_N), goes_N, np.where(np.isnan(goes_N), came_N, (1.0 - passed) * came_N + passed * goes_N)
    )
    told_N = np.where(between, ways_N, series.reading_N)
    carried = np.where(short, 1.0, CARRIED)
    off_N = np.hypot(carried * noise_N, step_N / np.where(between, lengths, 1) / np.sqrt(12.0))
    off_N[~between] = step_N / np.sqrt(12.0)
    within_N = np.where(between | short, 0.0, 0.5 * step_N + CARRIED * noise_N)
    unit_N = float(np.mean(off_N[series.counts & (within_N == 0.0)] ** -2.0)) ** -0.5
    rounding_N = series.reading_N - told_N
    return replace(series, noise_N=unit_N, rounding_N=rounding_N, trust=unit_N / off_N, within_N=within_N)


def _noise_N(series: Series) -> float:
    """Noise in front of the converter: so often it changes the reading while the force rests [N].

    Two readings of a resting force differ with the mean difference of two values of the noise over the step.
    """
    count = series.time_s.size // REST
    parts = series.reading_N[: count * REST].reshape(count, REST)
    there = series.counts[: count * REST].reshape(count, REST).all(axis=1)
    rests = there & (np.abs(parts[:, -1] - parts[:, 0]) < 1.5 * series.lattice_N)
    if not rests.any():
        return 0.0
    moves = np.diff(parts[rests], axis=1)
    differ_N = 0.0
    for one in moves:
        steps = one[one != 0.0]
        differ_N += float(np.sum(np.abs(steps[1:])[steps[1:] * steps[:-1] < 0.0]))
    return differ_N / moves.size * float(np.sqrt(np.pi)) / 2.0
