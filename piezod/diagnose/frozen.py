"""Readings that stand still while the force moves: to the last bit, or with the noise of the electronics."""

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.series import Series

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FROZEN_SAMPLES = 8  # equal readings in a row that noise does not make, while the model moves
REPEATED = 0.05  # share of readings equal to the one before, below which noise never repeats one for long
REPEATED_AT_REST = 0.5  # the same where the command rests: more of them may be how this bench reads
FROZEN_MOVES = 6.0  # by how many noises the model moves meanwhile
LEAP, FAR = 1.5, 2.5  # steps of a coarse lattice
LATE = 0.25  # of a stretch on a coarse lattice, at its end
STILL_WINDOWS = (16, 64, 256, 1024)  # samples in which a noisy reading is looked at
STILL = 2.0  # noises that it spreads by at most,
MOVING = 6.0  # and that the model spreads by at least
STAYS = 5.0  # noises from its level, within which a reading stands still
ABRUPT = 3.0  # times what the model, or a reading that stands still, moves in a sample: a sensor comes back in a leap
FOLLOWS = 0.5  # of the way that the model went meanwhile, that the leap makes up


def frozen_stretches(series: Series, model_N: Array) -> list[tuple[int, int]]:
    """Stretches (first, end) in which the reading stands still to the last bit though the model moves, or noise does.

    On a coarse lattice not those at the lowest or highest reading: there the force itself may have met a limit. Nor
    those that a slow reading makes on it: what was frozen leaps to where the force is by then, what is slow goes on
    by a step of the lattice. Nor those through which the model rests until shortly before their end: the force went on
    then, and its reading was late.
    """
    same = np.concatenate(([False], np.diff(series.reading_N) == 0.0, [False]))
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

    It must end by a leap to where the model has gone by then, while the model itself moves smoothly. So neither a delay
    (the model moves at the begin), nor a gap or a limit (the force meets it smoothly), nor friction passes for it.
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
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            stretch = _whole_stretch(y, int(first), int(last) - 1 + window, noise_N)
            if all(stretch[0] >= end or stretch[1] <= begin for begin, end in found) and _comes_back(
                y, model_N, stretch, noise_N
            ):
                found.append(stretch)
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


def _comes_back(y: Array, model_N: Array, stretch: tuple[int, int], noise_N: float) -> bool:
    """Whether the model moves in both halves of a stretch, and the reading leaps to it at the end."""
    first, end = stretch
    if end >= y.size - 1 or end - first < FROZEN_SAMPLES:
        return False
    middle = (first + end) // 2
    if min(np.ptp(model_N[first:middle]), np.ptp(model_N[middle:end])) < MOVING * noise_N:
        return False
    leap, way = y[end] - np.median(y[first:end]), model_N[end] - model_N[first]
    smooth = max(abs(model_N[end] - model_N[end - 1]), STAYS * noise_N)
    return bool(abs(leap) > ABRUPT * smooth and abs(leap - way) < FOLLOWS * abs(way))


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
