"""Search for stuck readings: a sensor that is frozen, or clipped at an end of its range, while its drive moves.

A run of identical values also has other causes. The command may be constant. A coarse converter gives an equal value
over a small move of the drive. Dry friction holds a stack after each reversal. A run is stuck if the drive moves much
farther in it than usual between two changes of the reading. One of these conditions must hold as well:

- The reading is noisy: a noisy reading repeats no value for long.
- The reading jumps at the end of the run.
- The drive moves by more than half its swing.
- The reading is at its extreme value, and the drive moves on outwards.

The method and its limits are derived here.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.estimation.recordings.noise import white_noise
from piezod.recording.stretches import Stretch, long_runs, pairs

SHORTEST = 5  # shortest run that is tested [samples]; a shorter one does not affect a fit
UNUSUAL = 10  # factor above the usual move of the drive, the usual step of the reading, or the noise of the drive
SMALLEST_MOVE = 0.005
"""Smallest move of the drive in a stuck run [share of the drive's swing]; a smaller one does not affect a fit."""

TRIMMED = 10
"""Denominator of the share of a run that is ignored at each end, because a reading may follow its drive late."""

ALTERNATING = 0.3  # share of consecutive steps of opposite sign above which a reading is noisy; white noise has 2/3
WINDOWS, WINDOW, FEWEST_RUNS = 16, 2**16, 100
"""Windows of a long recording for its usual motion; number of windows, samples of each, least number of runs."""

FOLLOWS = 0.3  # smallest magnitude of the correlation between reading and drive; below it a reading is not tested
Runs = tuple[NDArray[np.intp], NDArray[np.intp]]  # (first samples, samples after the ends) of runs, each shape (runs,)


@dataclass(frozen=True)
class StuckStretches:
    """Stretches in which a reading is stuck: frozen within its range, or clipped at its largest or smallest value."""

    frozen: list[Stretch]
    at_largest: list[Stretch]
    at_smallest: list[Stretch]

    @property
    def stretches(self) -> list[Stretch]:
        """All stretches."""
        return [*self.frozen, *self.at_largest, *self.at_smallest]


@dataclass(frozen=True)
class _TypicalMotion:
    """Usual motion of reading and drive."""

    move: float  # of the drive between two changes of the reading; moves up to it make up half of the drive's travel
    drive_noise: float  # standard deviation
    step: float  # median of the reading's steps
    noisy: bool  # whether the reading rarely repeats a value
    correlation: float  # of reading and drive, -1 to 1


def find_stuck(values: Array, drive: Array) -> StuckStretches:
    """Stretches in which a reading (nan: missing) does not follow its drive, such as the voltage; shape (N,) each."""
    low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
    swing = float(np.nanmax(drive, initial=-np.inf) - np.nanmin(drive, initial=np.inf))
    if not (low < high and swing > 0.0) or not ((values > low) & (values < high)).any():
        return StuckStretches([], [], [])  # a constant, or a flag of two values
    typical = _typical_motion(values, drive)
    runs = long_runs(values, SHORTEST)
    if abs(typical.correlation) < FOLLOWS or not runs[0].size:
        return StuckStretches([], [], [])
    limit = max(SMALLEST_MOVE * swing + UNUSUAL * typical.drive_noise, UNUSUAL * typical.move)
    bottom, top = _range(drive, *runs)
    moved = top - bottom > limit
    outwards = (top - drive[runs[0]] > limit, drive[runs[0]] - bottom > limit)
    beyond_top, beyond_bottom = outwards if typical.correlation > 0.0 else outwards[::-1]
    certain = _without_noise(values, drive, runs, limit, typical) | (moved & typical.noisy)
    at_top, at_bottom = values[runs[0]] == high, values[runs[0]] == low
    largest = _clipped(at_top, moved, certain | beyond_top)
    smallest = _clipped(at_bottom, moved, certain | beyond_bottom)
    kinds = (certain & ~at_top & ~at_bottom, largest, smallest)
    return StuckStretches(*(pairs(runs[0][kind], runs[1][kind]) for kind in kinds))


def _clipped(extreme: NDArray[np.bool_], moved: NDArray[np.bool_], certain: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which runs at an extreme value are clipped: if one of them is certain, all in which the drive moves."""
    result: NDArray[np.bool_] = extreme & (moved | certain) & (extreme & certain).any()
    return result


def _without_noise(values: Array, drive: Array, runs: Runs, limit: float, typical: _TypicalMotion) -> NDArray[np.bool_]:
    """Which runs of a reading without noise are stuck: it jumps after the run, or the drive moves by half its swing.

    The ends of a run are ignored, see `TRIMMED`.
    """
    starts, stops = runs
    trimmed = (stops - starts) // TRIMMED
    bottom, top = _range(drive, starts + trimmed, stops - trimmed)
    jumps = np.abs(values[np.minimum(stops, values.size - 1)] - values[stops - 1]) > UNUSUAL * typical.step
    half = 0.5 * (np.nanmax(drive) - np.nanmin(drive))
    result: NDArray[np.bool_] = (jumps & (top - bottom > limit)) | (top - bottom > half)
    return result


def _range(drive: Array, starts: NDArray[np.intp], stops: NDArray[np.intp]) -> tuple[Array, Array]:
    """Smallest and largest value of the drive in each run."""
    places = np.column_stack((starts, np.minimum(stops, drive.size - 1))).ravel()
    return np.fmin.reduceat(drive, places)[::2], np.fmax.reduceat(drive, places)[::2]


def _typical_motion(values: Array, drive: Array) -> _TypicalMotion:
    """Usual motion, from windows of the recording that grow until they hold enough runs."""
    size = WINDOW
    parts = _windows(values.size, size)
    while (motion := _statistics(values, drive, parts)) is None and size * WINDOWS < values.size:
        size *= 8
        parts = _windows(values.size, size)
    return motion or _TypicalMotion(np.inf, 0.0, np.inf, noisy=False, correlation=0.0)


def _windows(samples: int, size: int) -> list[slice]:
    """Windows at equal distances over a recording; a short recording is one window."""
    if samples <= WINDOWS * size:
        return [slice(0, samples)]
    return [slice(start, start + size) for start in np.linspace(0, samples - size, WINDOWS).astype(int).tolist()]


def _statistics(values: Array, drive: Array, parts: list[slice]) -> _TypicalMotion | None:
    """Usual motion within these parts; None if they hold too few changes of the reading."""
    moves, lengths, steps, bends, turns, products = [], [], [], [], [], np.zeros((2, 2))
    for part in parts:
        y, u = values[part], drive[part]
        edges = np.flatnonzero(y[1:] != y[:-1]) + 1
        moves.append(np.abs(np.diff(u[edges])))
        lengths.append(np.diff(edges))
        dy = y[edges] - y[edges - 1]
        both = np.isfinite(y) & np.isfinite(u)
        products += np.cov(y[both], u[both], bias=True) if both.any() else 0.0
        dy = dy[np.isfinite(dy)]
        steps.append(np.abs(dy))
        turns.append(np.sign(dy[1:]) != np.sign(dy[:-1]))
        bends.append(np.abs(np.diff(u, 2)))
    every_step, every_length = np.concatenate(steps), np.concatenate(lengths).astype(np.float64)
    if every_step.size < 2 or (every_length.size < FEWEST_RUNS and len(parts) > 1):
        return None
    alternating = float(np.mean(np.concatenate(turns)))
    return _TypicalMotion(
        move=_half_sum_part(np.concatenate(moves)),
        drive_noise=white_noise(np.concatenate(bends)),
        step=float(np.median(every_step)),
        noisy=alternating > ALTERNATING and _half_sum_part(every_length) <= 2.0,
        correlation=float(products[0, 1] / spread) if (spread := np.sqrt(products[0, 0] * products[1, 1])) else 0.0,
    )


def _half_sum_part(parts: Array) -> float:
    """Smallest part for which this part and all smaller ones make up half of the sum of all parts."""
    ordered = np.sort(parts[np.isfinite(parts)])
    total = np.cumsum(ordered)
    return float(ordered[np.searchsorted(total, 0.5 * total[-1])]) if ordered.size else 0.0
