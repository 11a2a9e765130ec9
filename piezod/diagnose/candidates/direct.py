"""Tests of their own for what leaves a mark in the readings: noise, lines, the skew of the clocks."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
