"""Readings that stand still while the force moves: to the last bit, or with the noise of the electronics."""

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FROZEN_SAMPLES = 8  # equal readings in a row that noise does not make, while the model moves
REPEATED = 0.05  # share of readings equal to the one before, below which noise never repeats one for long
REPEATED_AT_REST = 0.5  # the same where the command rests: more of them may be how this bench reads
FROZEN_MOVES = 6.0  # by how many noises the model moves meanwhile
LEAP, FAR = 1.5, 2.5  # steps of a coarse lattice
LATE = 0.25  # of a stretch on a coarse lattice, at its end
STILL_WINDOWS = (16, 64, 256, 1024)  # samples in which a noisy reading is looked at
MOST_RUNS = 64  # of such windows, the longest, that are looked at: each costs a pass over the recording
STILL = 2.0  # noises that it spreads by at most,
MOVING = 6.0  # and that the model spreads by at least
STAYS = 5.0  # noises from its level, within which a reading stands still
ABRUPT = 3.0  # times what the model, or a reading that stands still, moves in a sample: a sensor comes back in a leap
ONSET = 0.1  # of the model's way in a stretch, at which it begins
PARTS, POINTS, NEAREST = 32, 64, 64  # of a stretch; samples of one that are looked at; stretches on either side
ALIKE, LARGE = 0.95, 0.5  # correlation and size of moves that are like the one in it
FEWEST_ALIKE, MOSTLY_FOLLOWS = 2, 0.25  # of them, and the share that may stand still too
FOLLOWS = 0.5  # of the way that the model went meanwhile, that the leap makes up


def frozen_stretches(series: Series, model_N: Array) -> list[tuple[int, int]]:
    """Stretches (first, end) in which the reading stands still to the last bit though the model moves, or noise does.

    On a coarse lattice not those at the lowest or highest reading: there the force itself may have met a limit. Nor
    those that a slow reading makes on it: what was frozen leaps to where the force is by then, what is slow goes on
    by a step of the lattice. Nor those through which the model rests until shortly before their end: the force went on
    then, and its reading was late.
    """
    counts = series.counts
    same = np.concatenate(([False], (np.diff(series.reading_N) == 0.0) & counts[1:] & counts[:-1], [False]))
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    stretches = [(int(a), int(b) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    shortest = max(FROZEN_SAMPLES, 4 * _usual_run(stretches))
    proved = _never_repeats(series, same[1:-1], [end - first for first, end in stretches if end - first < shortest])
    moves_N = -1.0 if proved else FROZEN_MOVES * max(series.noise_N, series.lattice_N)
    readings = series.reading_N[series.counts]
    limits = float(readings.min()), float(readings.max())
    coarse = series.lattice_N > series.noise_N
    found = [
        (first, end)
        for first, end in stretches
        if end - first >= shortest
        and np.ptp(model_N[first : end - int(LATE * (end - first)) if coarse else end]) > moves_N
        and not (coarse and series.reading_N[first] in limits)
    ]
    return _leaping(series, model_N, found) if coarse else found


def still_stretches(series: Series, model_N: Array) -> list[tuple[int, int]]:
    """Stretches (first, end) in which the reading keeps a level, with its noise, though the model moves throughout.

    It must end by a leap to where the model has gone by then, while the model itself moves smoothly. So neither a gap
    nor a limit (the force meets it smoothly) nor friction passes for it. A delay does where the model moves at once and
    then rests: such a stretch counts where the reading follows the model's other moves of this shape.
    """
    y, noise_N = series.reading_N, max(series.noise_N, series.lattice_N)
    if not series.counts.all():
        y = np.where(series.counts, y, model_N)
    found: list[tuple[int, int]] = []
    for window in STILL_WINDOWS:
        if 4 * window > y.size:
            break
        still = _spread(y, window) < STILL * noise_N
        still &= _spread(model_N, window) > MOVING * noise_N
        edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
        runs = sorted(zip(edges[::2], edges[1::2], strict=True), key=lambda run: run[0] - run[1])
        for first, last in runs[:MOST_RUNS]:
            whole = _whole_stretch(y, int(first), int(last) - 1 + window, noise_N)
            if all(whole[0] >= end or whole[1] <= begin for begin, end in found):
                stretch = _coming_back(y, model_N, whole, noise_N)
                found += [] if stretch is None else [stretch]
    return sorted(found)


def _spread(values: Array, window: int) -> Array:
    """Standard deviation in every window, shape (N - window + 1,)."""
    centred = values - values.mean()
    sums, squares = (np.concatenate(([0.0], np.cumsum(one))) for one in (centred, centred**2))
    mean = (sums[window:] - sums[:-window]) / window
    result: Array = np.sqrt(np.maximum((squares[window:] - squares[:-window]) / window - mean**2, 0.0))
    return result


def _whole_stretch(y: Array, first: int, end: int, noise_N: float) -> tuple[int, int]:
    """From the middle of a stretch in both directions, as far as the reading stays at its level."""
    level = float(np.median(y[first:end]))
    leaves = np.abs(y - level) > STAYS * noise_N
    middle = (first + end) // 2
    before, behind = np.flatnonzero(leaves[:middle]), np.flatnonzero(leaves[middle:])
    return (int(before[-1]) + 1 if before.size else 0), (middle + int(behind[0]) if behind.size else y.size)


def _coming_back(y: Array, model_N: Array, stretch: tuple[int, int], noise_N: float) -> tuple[int, int] | None:
    """The stretch, from where the model moves, if the reading leaps at its end to where the model has gone."""
    first, end = stretch
    if end >= y.size - 1 or end - first < FROZEN_SAMPLES:
        return None
    leap, way = y[end] - np.median(y[first:end]), model_N[end] - model_N[first]
    smooth = max(abs(model_N[end] - model_N[end - 1]), STAYS * noise_N)
    if abs(leap) <= ABRUPT * smooth or abs(leap - way) >= FOLLOWS * abs(way):
        return None
    middle = (first + end) // 2
    if min(np.ptp(model_N[first:middle]), np.ptp(model_N[middle:end])) >= MOVING * noise_N:
        return stretch
    away = np.abs(model_N[first:end] - model_N[first])
    moving = first + max(int(np.argmax(away > ONSET * away.max())) - 1, 0), end
    return moving if _follows_elsewhere(y, model_N, moving) else None


def _follows_elsewhere(y: Array, model_N: Array, stretch: tuple[int, int]) -> bool:
    """Whether the reading follows the model where that moves as in a stretch, before and behind it."""
    first, end = stretch
    size = end - first
    nearest = np.arange(max(0, first - NEAREST * size), min(y.size, end + NEAREST * size) - size, max(1, size // PARTS))
    begins = nearest[(nearest + size <= first) | (nearest >= end)]
    if not begins.size:
        return False
    looked_at = np.linspace(0, size - 1, min(size, POINTS)).astype(int)
    moves, follows = (one[begins[:, None] + looked_at] - one[begins][:, None] for one in (model_N, y))
    shape = model_N[first + looked_at] - model_N[first]
    own, length = np.linalg.norm(moves, axis=1), float(np.linalg.norm(shape))
    alike = (np.abs(moves @ shape) > ALIKE * own * length) & (own > LARGE * length)
    still = np.linalg.norm(follows[alike], axis=1) < LARGE * own[alike]
    return bool(np.count_nonzero(alike) >= FEWEST_ALIKE and np.mean(still) < MOSTLY_FOLLOWS)


def _leaping(series: Series, model_N: Array, stretches: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Those that end in a leap, and where some do the others too, unless one of them is surely a slow reading."""
    y, step_N = series.reading_N, series.lattice_N
    ended = [(first, end) for first, end in stretches if end < y.size]
    leaps = [(first, end) for first, end in ended if abs(y[end] - y[first]) > LEAP * step_N]
    slow = [one for one in ended if one not in leaps and abs(model_N[one[1]] - model_N[one[0]]) > FAR * step_N]
    return stretches if leaps and not slow else leaps


def _never_repeats(series: Series, same: Mask, short: list[int]) -> bool:
    """Whether a reading hardly ever comes twice in a row, not where the command rests either: noise sees to that.

    `same`: which readings equal the one before; `short`: lengths of the runs of them that are no stretch.
    """
    resting = np.diff(series.command_V) == 0.0
    at_rest = float(same[resting].mean()) if resting.any() else 0.0
    return sum(short) - len(short) < REPEATED * same.size and at_rest < REPEATED_AT_REST


def _usual_run(stretches: list[tuple[int, int]]) -> int:
    """Length that runs of equal readings have on a coarse lattice anyway."""
    lengths = np.array([end - first for first, end in stretches if end - first > 1])
    return int(np.percentile(lengths, 90)) if lengths.size > 50 else 1
