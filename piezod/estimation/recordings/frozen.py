"""Frozen readings: equal readings, or only noise of the electronics, while the force moves."""

import numpy as np

from piezod.arrays import Array, Mask
from piezod.estimation.recordings.series import Series
from piezod.recording.stretches import stretches_of

FROZEN_SAMPLES = 8  # fewest equal readings in a row; noise hardly repeats a reading so often
REPEATED = 0.05  # share of repeated readings below which noise prevents long runs of equal readings
REPEATED_AT_REST = 0.5  # share of repeated readings at rest above which the bench may repeat readings by itself
FROZEN_MOVES = 6.0  # least motion of the model during a frozen stretch [noise rms]
LEAP, FAR = 1.5, 2.5  # least jump at the end, and motion of the model that must cause one [converter steps]
LATE_SHARE = 0.25  # last share of a stretch on a coarse converter that does not count as motion: a reading may be late
STILL_WINDOWS = (16, 64, 256, 1024)  # lengths of the windows for noisy frozen readings [samples]
MOST_RUNS = 64  # longest runs of such windows that are examined: each takes a pass over the recording
STILL = 2.0  # largest spread of a frozen reading [noise rms]
MOVING = 6.0  # least spread of the model [noise rms]
LEVEL_NOISES = 5.0  # largest distance of a frozen reading from its level [noise rms]
ABRUPT = 3.0  # least jump at the end over the motion of the model in a sample: a sensor recovers abruptly
ONSET = 0.1  # share of the motion in a stretch at which the motion begins
PARTS, POINTS, NEAREST = 32, 64, 64  # positions per stretch, samples compared, and stretches searched on either side
SIMILAR, LARGE = 0.95, 0.5  # least correlation and relative size of a similar motion
FEWEST_SIMILAR, MOST_STILL = 2, 0.25  # fewest similar motions, and largest share of them with a still reading
FOLLOWS = 0.5  # largest deviation of the jump from the motion of the model, relative to the motion


def frozen_stretches(series: Series, model_N: Array) -> list[tuple[int, int]]:
    """Stretches (first, end) of equal readings during which the model or the noise moves.

    On a coarse converter three kinds of stretches are excluded:

    - Stretches at the lowest or highest reading, where the force may have met a limit.
    - Stretches of a slow reading, which changes by one step at the end; a frozen reading jumps to the force.
    - Stretches in which the model moves only near the end, where the reading is late.
    """
    counts = series.counts
    equal = (np.diff(series.reading_N) == 0.0) & counts[1:] & counts[:-1]
    stretches = [(first, last + 1) for first, last in stretches_of(equal)]
    shortest = max(FROZEN_SAMPLES, 4 * _long_run(stretches))
    short = [end - first for first, end in stretches if end - first < shortest]
    moves_N = -1.0 if _never_repeats(series, equal, short) else FROZEN_MOVES * max(series.noise_N, series.lattice_N)
    readings = series.reading_N[series.counts]
    limits = float(readings.min()), float(readings.max())
    coarse = series.lattice_N > series.noise_N
    frozen = [
        (first, end)
        for first, end in stretches
        if end - first >= shortest
        and np.ptp(model_N[first : end - int(LATE_SHARE * (end - first)) if coarse else end]) > moves_N
        and not (coarse and series.reading_N[first] in limits)
    ]
    return _with_jump(series, model_N, frozen) if coarse else frozen


def still_stretches(series: Series, model_N: Array) -> list[tuple[int, int]]:
    """Stretches (first, end) in which the reading keeps a level with noise, while the model moves throughout.

    The reading must jump to the model at the end, while the model moves smoothly. This excludes a gap, a limit and
    friction. A delay also has such a jump if the model moves at once and then rests. Such a stretch counts only if the
    reading follows similar motions of the model elsewhere.
    """
    y, noise_N = series.reading_N, max(series.noise_N, series.lattice_N)
    if not series.counts.all():
        y = np.where(series.counts, y, model_N)
    frozen: list[tuple[int, int]] = []
    for window in STILL_WINDOWS:
        if 4 * window > y.size:
            break
        still = _spread(y, window) < STILL * noise_N
        still &= _spread(model_N, window) > MOVING * noise_N
        runs = sorted(stretches_of(still), key=lambda run: run[0] - run[1])
        for first, last in runs[:MOST_RUNS]:
            stretch = _extended(y, first, last - 1 + window, noise_N)
            if all(stretch[0] >= end or stretch[1] <= begin for begin, end in frozen):
                recovered = _with_recovery(y, model_N, stretch, noise_N)
                frozen += [] if recovered is None else [recovered]
    return sorted(frozen)


def _spread(values: Array, window: int) -> Array:
    """Standard deviation in every window, shape (N - window + 1,)."""
    centred = values - values.mean()
    sums, squares = (np.concatenate(([0.0], np.cumsum(terms))) for terms in (centred, centred**2))
    mean = (sums[window:] - sums[:-window]) / window
    result: Array = np.sqrt(np.maximum((squares[window:] - squares[:-window]) / window - mean**2, 0.0))
    return result


def _extended(y: Array, first: int, end: int, noise_N: float) -> tuple[int, int]:
    """Stretch, extended in both directions as far as the reading keeps its level."""
    level = float(np.median(y[first:end]))
    beyond = np.abs(y - level) > LEVEL_NOISES * noise_N
    middle = (first + end) // 2
    before, behind = np.flatnonzero(beyond[:middle]), np.flatnonzero(beyond[middle:])
    return (int(before[-1]) + 1 if before.size else 0), (middle + int(behind[0]) if behind.size else y.size)


def _with_recovery(y: Array, model_N: Array, stretch: tuple[int, int], noise_N: float) -> tuple[int, int] | None:
    """Stretch from the onset of the model's motion, if the reading jumps to the model at its end; otherwise None."""
    first, end = stretch
    if end >= y.size - 1 or end - first < FROZEN_SAMPLES:
        return None
    jump, motion = y[end] - np.median(y[first:end]), model_N[end] - model_N[first]
    smooth = max(abs(model_N[end] - model_N[end - 1]), LEVEL_NOISES * noise_N)
    if abs(jump) <= ABRUPT * smooth or abs(jump - motion) >= FOLLOWS * abs(motion):
        return None
    before = max(first - 1, 0)  # a reading of which the model is a sample late does not agree with it again at the end
    if abs((y[end] - model_N[end]) - (y[before] - model_N[before])) >= FOLLOWS * abs(motion):
        return None
    middle = (first + end) // 2
    if min(np.ptp(model_N[first:middle]), np.ptp(model_N[middle:end])) >= MOVING * noise_N:
        return stretch
    distance = np.abs(model_N[first:end] - model_N[first])
    moving = first + max(int(np.argmax(distance > ONSET * distance.max())) - 1, 0), end
    return moving if _follows_elsewhere(y, model_N, moving) else None


def _follows_elsewhere(y: Array, model_N: Array, stretch: tuple[int, int]) -> bool:
    """Whether the reading follows similar motions of the model before and after a stretch."""
    first, end = stretch
    size = end - first
    nearest = np.arange(max(0, first - NEAREST * size), min(y.size, end + NEAREST * size) - size, max(1, size // PARTS))
    begins = nearest[(nearest + size <= first) | (nearest >= end)]
    if not begins.size:
        return False
    samples = np.linspace(0, size - 1, min(size, POINTS)).astype(int)
    motions, readings = (values[begins[:, None] + samples] - values[begins][:, None] for values in (model_N, y))
    shape = model_N[first + samples] - model_N[first]
    sizes, length = np.linalg.norm(motions, axis=1), float(np.linalg.norm(shape))
    similar = (np.abs(motions @ shape) > SIMILAR * sizes * length) & (sizes > LARGE * length)
    still = np.linalg.norm(readings[similar], axis=1) < LARGE * sizes[similar]
    return bool(np.count_nonzero(similar) >= FEWEST_SIMILAR and np.mean(still) < MOST_STILL)


def _with_jump(series: Series, model_N: Array, stretches: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Stretches that end with a jump; if there are some, all stretches unless one is certainly a slow reading."""
    y, step_N = series.reading_N, series.lattice_N
    ended = [(first, end) for first, end in stretches if end < y.size]
    jumping = [(first, end) for first, end in ended if abs(y[end] - y[first]) > LEAP * step_N]
    others = (stretch for stretch in ended if stretch not in jumping)
    is_slow = any(abs(model_N[end] - model_N[first]) > FAR * step_N for first, end in others)
    return stretches if jumping and not is_slow else jumping


def _never_repeats(series: Series, equal: Mask, short: list[int]) -> bool:
    """Whether noise prevents repeated readings, also where the command rests.

    `equal`: readings equal to the previous one; `short`: lengths of the runs that are too short to be frozen.
    """
    resting = np.diff(series.command_V) == 0.0
    at_rest = float(equal[resting].mean()) if resting.any() else 0.0
    return sum(short) - len(short) < REPEATED * equal.size and at_rest < REPEATED_AT_REST


def _long_run(stretches: list[tuple[int, int]]) -> int:
    """Length that 90 % of the runs of equal readings do not exceed, as on a coarse converter; 1 for few runs."""
    lengths = np.array([end - first for first, end in stretches if end - first > 1])
    return int(np.percentile(lengths, 90)) if lengths.size > 50 else 1
