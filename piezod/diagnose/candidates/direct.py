"""Direct estimates from the readings: spectral lines, resonance peaks, and skew of the clocks."""

import itertools
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.estimation.recordings.series import Series

LINE_OVER_MEDIAN = 30.0  # least power of a line over the median around it; noise reaches 18 in 1e6 bins
PEAK_PARTS_S = (4.0, 0.5, 0.25)  # lengths of the averaged parts of a recording
MOST_PEAKS = 3  # of the parts of one length
PEAK_DISTANCE = 0.1  # least relative distance of two peaks
SURROUNDINGS, NEIGHBOURS = 101, 20  # bins for the running median, and bins on either side of a tone
LOBE, WANDERS_HZ = 4, 0.1  # half width of a Hann window's lobe [bins], and frequency by which a tone may wander
SKEWS_PPM, SKEWED = np.geomspace(30.0, 2e4, 90), 0.98  # magnitudes tried; largest loss ratio of a visible skew
SKEW_ROWS = 10_000  # samples that are compared


@dataclass(frozen=True)
class Line:
    """Narrow peak in the spectrum of a residual."""

    frequency_Hz: float
    amplitude_N: float
    over_median: float


def lines(series: Series, residual_N: Array, most: int = 6) -> list[Line]:
    """Narrow peaks of a residual without a line of the command at their frequency, the highest first."""
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
    peaks: list[Line] = []
    candidates = np.flatnonzero((prominence > LINE_OVER_MEDIAN) & ~driven)
    for k in sorted(candidates, key=lambda j: -power[j]):
        if k < SURROUNDINGS and power[k] < LINE_OVER_MEDIAN * _level_near(power, int(k), float(frequency_Hz[1])):
            continue  # a steep spectrum at low frequencies has no line
        if k < first or any(abs(frequency_Hz[k] - line.frequency_Hz) < 5 * frequency_Hz[1] for line in peaks):
            continue
        peaks.append(_refined(series, values, float(frequency_Hz[k]), float(frequency_Hz[1]), float(prominence[k])))
        if len(peaks) == most:
            break
    return peaks


def _refined(series: Series, values: Array, near_Hz: float, bin_Hz: float, over: float) -> Line:
    """Frequency and amplitude by least squares on a fine grid around a bin."""
    largest, best_Hz = 0.0, near_Hz
    window = np.hanning(values.size)
    for frequency_Hz in near_Hz + bin_Hz * np.linspace(-1.0, 1.0, 41):
        angle = 2.0 * np.pi * frequency_Hz * series.time_s
        sine, cosine = 2.0 * np.mean(window * values * np.sin(angle)), 2.0 * np.mean(window * values * np.cos(angle))
        amplitude = float(np.hypot(sine, cosine)) / float(window.mean())
        if amplitude > largest:
            largest, best_Hz = amplitude, float(frequency_Hz)
    return Line(best_Hz, largest, over)


def level_about(series: Series, residual_N: Array, frequency_Hz: float) -> float:
    """Standard deviation of white noise with the spectral density of a residual around a frequency [N]."""
    window = np.hanning(residual_N.size)
    values = np.where(series.counts, residual_N, 0.0)
    power = np.abs(np.fft.rfft((values - values.mean()) * window)) ** 2 / float(window @ window)
    middle = round(frequency_Hz * series.dt_s * residual_N.size)
    around = power[max(middle - NEIGHBOURS, 1) : middle + NEIGHBOURS + 1]
    return float(np.sqrt(around.mean())) if around.size else series.noise_N


def skew_ppm(series: Series, modelled_N: Array) -> float | None:
    """Skew of the clocks with the best fit of a simulation to the readings, with free gain and offset; None: no skew.

    It is the start of a fit, which would not converge to a large skew from zero.
    """
    rows = slice(None, None, -(-series.time_s.size // SKEW_ROWS))
    counts = series.counts[rows]
    time_s, reading_N = series.time_s[rows][counts], series.reading_N[rows][counts]
    reading_N = reading_N - reading_N.mean()

    def loss(ppm: float) -> float:
        skewed_N = np.interp(time_s * (1.0 + 1e-6 * ppm), series.time_s, modelled_N)
        skewed_N = skewed_N - skewed_N.mean()
        return float(reading_N @ reading_N - (skewed_N @ reading_N) ** 2 / max(float(skewed_N @ skewed_N), 1e-300))

    best = min((*SKEWS_PPM, *-SKEWS_PPM), key=loss)
    return float(best) if loss(best) < SKEWED * loss(0.0) else None


def _running_median(power: Array) -> Array:
    """Median over neighbouring bins, interpolated between medians of chunks."""
    chunks = max(power.size // SURROUNDINGS, 1)
    edges = np.linspace(0, power.size, chunks + 1).astype(int)
    medians = np.array([np.median(power[a:b]) for a, b in itertools.pairwise(edges)])
    result: Array = np.interp(np.arange(power.size), 0.5 * (edges[:-1] + edges[1:]), medians)
    return result


def _level_near(power: Array, k: int, bin_Hz: float) -> float:
    """Median power of the nearest bins on both sides that a wandering line does not reach."""
    free = max(LOBE, int(np.ceil(WANDERS_HZ / bin_Hz)))
    below, above = (
        power[max(k - free - NEIGHBOURS, 1) : max(k - free, 1)],
        power[k + free + 1 : k + free + 1 + NEIGHBOURS],
    )
    return float(np.median(np.append(below, above)))


def peaks_Hz(series: Series, residual_N: Array) -> list[float]:
    """Frequencies of peaks in the smoothed spectrum of a residual, as resonances have.

    The spectrum is averaged over long and over short parts. In a spectrum of short parts a well damped mode is narrow.
    """
    peaks: list[float] = []
    for part_s in PEAK_PARTS_S:
        new = _peaks_of_parts_Hz(series, residual_N, part_s)
        peaks += [f for f in new if all(abs(f / other - 1.0) > PEAK_DISTANCE for other in peaks)]
    return peaks


def _peaks_of_parts_Hz(series: Series, residual_N: Array, part_s: float) -> list[float]:
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
    return [float(frequency_Hz[k]) for k in sorted(tops, key=lambda j: -above[j])[:MOST_PEAKS]]
