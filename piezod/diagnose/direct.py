"""Tests of their own for what leaves a mark in the readings: frozen stretches, a lattice, lines."""

import itertools
from dataclasses import dataclass

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
LINE_OVER_MEDIAN = 30.0  # power of a line over the median of its surroundings; exponential noise reaches 18 in 1e6 bins
PEAK_PARTS_S, SAME_PEAK = (4.0, 0.5, 0.25), 0.1  # of a recording, averaged; of a frequency
SURROUNDINGS, ABOUT = 101, 20  # bins; on either side of a tone
LOBE, WANDERS_HZ = 4, 0.1  # bins of a Hann window's own; by which a tone may wander
SKEWS_PPM, SKEWED = np.geomspace(30.0, 2e4, 90), 0.98  # tried in both directions; of the squares, where one shows
SKEW_ROWS = 10_000


@dataclass(frozen=True)
class Line:
    """A narrow peak in the residual."""

    frequency_Hz: float
    amplitude_N: float
    phase_rad: float
    over_median: float


def noise_of(u: Array, y: Array, good: NDArray[np.bool_]) -> float:
    """Standard deviation of a recording's noise, from second differences where the drive moves least."""
    bends, drive = np.diff(y, 2), np.abs(np.diff(u, 2))
    usable = good[2:] & good[1:-1] & good[:-2]
    if np.count_nonzero(usable) < 100:
        return max(1e-4 * float(np.ptp(y[good])), 1e-12)
    quiet = usable & (drive <= np.percentile(drive[usable], 50))
    spread = 1.4826 * float(np.median(np.abs(bends[quiet]))) / float(np.sqrt(6.0))
    return max(spread, 2e-5 * float(np.ptp(y[good])), 1e-12)


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


def lines(series: Series, residual_N: Array, most: int = 6) -> list[Line]:
    """Narrow peaks of a residual that the command has not at the same frequency, the highest first."""
    window = np.hanning(residual_N.size)
    values = np.where(series.counts, residual_N, 0.0)
    spectrum = np.fft.rfft((values - values.mean()) * window)
    power = np.abs(spectrum) ** 2
    drive = np.abs(np.fft.rfft((series.command_V - series.command_V.mean()) * window)) ** 2
    frequency_Hz = np.fft.rfftfreq(residual_N.size, series.dt_s)
    surroundings, drive_around = _running_median(power), _running_median(drive)
    prominence = power / np.maximum(surroundings, 1e-300)
    driven = drive > 20.0 * np.maximum(drive_around, 1e-12 * drive.max())
    first = max(4, int(0.5 / (frequency_Hz[1] + 1e-300)))
    found: list[Line] = []
    candidates = np.flatnonzero((prominence > LINE_OVER_MEDIAN) & ~driven)
    for k in sorted(candidates, key=lambda j: -power[j]):
        if k < SURROUNDINGS and power[k] < LINE_OVER_MEDIAN * _near(power, int(k), float(frequency_Hz[1])):
            continue  # a colour that falls within so few bins is no line
        if k < first or any(abs(frequency_Hz[k] - one.frequency_Hz) < 5 * frequency_Hz[1] for one in found):
            continue
        found.append(_refined(series, values, float(frequency_Hz[k]), float(frequency_Hz[1]), float(prominence[k])))
        if len(found) == most:
            break
    return found


def _refined(series: Series, values: Array, near_Hz: float, bin_Hz: float, over: float) -> Line:
    """Frequency, amplitude and phase by least squares on a fine grid around a bin."""
    best = (0.0, near_Hz, 0.0, 0.0)
    window = np.hanning(values.size)
    for frequency_Hz in near_Hz + bin_Hz * np.linspace(-1.0, 1.0, 41):
        angle = 2.0 * np.pi * frequency_Hz * series.time_s
        sine, cosine = 2.0 * np.mean(window * values * np.sin(angle)), 2.0 * np.mean(window * values * np.cos(angle))
        amplitude = float(np.hypot(sine, cosine)) / float(window.mean())
        if amplitude > best[0]:
            best = (amplitude, float(frequency_Hz), sine, cosine)
    phase = float(np.arctan2(best[3], best[2])) % (2.0 * np.pi)
    return Line(best[1], best[0], phase, over)


def level_about(series: Series, residual_N: Array, frequency_Hz: float) -> float:
    """Standard deviation of the white noise whose spectrum is as high as a residual's about a frequency [N]."""
    window = np.hanning(residual_N.size)
    values = np.where(series.counts, residual_N, 0.0)
    power = np.abs(np.fft.rfft((values - values.mean()) * window)) ** 2 / float(window @ window)
    middle = round(frequency_Hz * series.dt_s * residual_N.size)
    around = power[max(middle - ABOUT, 1) : middle + ABOUT + 1]
    return float(np.sqrt(around.mean())) if around.size else series.noise_N


def skew_ppm(series: Series, modelled_N: Array) -> float | None:
    """Skew of the clocks under which a simulation is most like the readings, gain and offset free; None: none shows.

    A fit that begins elsewhere arrives at no skew by which the end of a long record comes a swing of the force later.
    """
    rows = slice(None, None, -(-series.time_s.size // SKEW_ROWS))
    counts = series.counts[rows]
    time_s, reading_N = series.time_s[rows][counts], series.reading_N[rows][counts]
    reading_N = reading_N - reading_N.mean()

    def left(ppm: float) -> float:
        by = np.interp(time_s * (1.0 + 1e-6 * ppm), series.time_s, modelled_N)
        by = by - by.mean()
        return float(reading_N @ reading_N - (by @ reading_N) ** 2 / max(float(by @ by), 1e-300))

    best = min((*SKEWS_PPM, *-SKEWS_PPM), key=left)
    return float(best) if left(best) < SKEWED * left(0.0) else None


def _running_median(power: Array) -> Array:
    """Median over neighbouring bins, from medians of chunks."""
    chunks = max(power.size // SURROUNDINGS, 1)
    edges = np.linspace(0, power.size, chunks + 1).astype(int)
    medians = np.array([np.median(power[a:b]) for a, b in itertools.pairwise(edges)])
    result: Array = np.interp(np.arange(power.size), 0.5 * (edges[:-1] + edges[1:]), medians)
    return result


def _near(power: Array, k: int, bin_Hz: float) -> float:
    """Median over the nearest bins on both sides that a line's own wandering leaves free."""
    free = max(LOBE, int(np.ceil(WANDERS_HZ / bin_Hz)))
    below, above = power[max(k - free - ABOUT, 1) : max(k - free, 1)], power[k + free + 1 : k + free + 1 + ABOUT]
    return float(np.median(np.append(below, above)))


def peaks_Hz(series: Series, residual_N: Array, most: int = 3) -> list[float]:
    """Frequencies at which a residual's smoothed spectrum stands out most from its surroundings: modes that ring.

    Looked for in long parts and in short ones, in which a well damped mode is narrow among its surroundings too.
    """
    found: list[float] = []
    for part_s in PEAK_PARTS_S:
        new = _peaks_Hz(series, residual_N, part_s, most)
        found += [f for f in new if all(abs(f / other - 1.0) > SAME_PEAK for other in found)]
    return found


def _peaks_Hz(series: Series, residual_N: Array, part_s: float, most: int) -> list[float]:
    size = int(min(residual_N.size // 8, max(256, part_s / series.dt_s)))
    if size < 64:
        return []
    values = np.where(series.counts, residual_N, 0.0)
    window = np.hanning(size)
    parts = np.lib.stride_tricks.sliding_window_view(values, size)[:: size // 2]
    power = np.mean(np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2, axis=0)
    level = np.log(np.maximum(power, 1e-300))
    wide = np.convolve(np.pad(level, 20, mode="edge"), np.ones(41) / 41.0, mode="valid")
    above = level - wide
    inner = np.arange(3, level.size - 3)
    tops = inner[(level[inner] >= level[inner - 1]) & (level[inner] > level[inner + 1]) & (above[inner] > 1.0)]
    frequency_Hz = np.fft.rfftfreq(size, series.dt_s)
    return [float(frequency_Hz[k]) for k in sorted(tops, key=lambda j: -above[j])[:most]]
