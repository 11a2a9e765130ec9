"""Tests of their own for what leaves a mark in the readings: frozen stretches, a lattice, lines, sharp steps."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.series import Series

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FROZEN_SAMPLES = 8  # equal readings in a row that noise does not make, while the model moves
FROZEN_MOVES = 6.0  # by how many noises the model moves meanwhile
LINE_OVER_MEDIAN = 30.0  # power of a line over the median of its surroundings; exponential noise reaches 18 in 1e6 bins
SURROUNDINGS = 101  # bins
EDGE_NOISES = 5.0  # jump of the means on both sides of an edge, in standard errors


@dataclass(frozen=True)
class Line:
    """A narrow peak in the residual."""

    frequency_Hz: float
    amplitude_N: float
    phase_rad: float
    over_median: float


def frozen_stretches(series: Series, model_N: Array) -> list[tuple[int, int]]:
    """Stretches (first, end) in which the reading stands still to the last bit while the model moves."""
    same = np.concatenate(([False], np.diff(series.reading_N) == 0.0, [False]))
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    stretches = [(int(a), int(b) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    usual = _usual_run(stretches)
    return [
        (first, end)
        for first, end in stretches
        if end - first >= max(FROZEN_SAMPLES, 4 * usual)
        and np.ptp(model_N[first:end]) > FROZEN_MOVES * max(series.noise_N, lattice_step_N(series))
    ]


def _usual_run(stretches: list[tuple[int, int]]) -> int:
    """Length that runs of equal readings have on a coarse lattice anyway."""
    lengths = np.array([end - first for first, end in stretches if end - first > 1])
    return int(np.percentile(lengths, 90)) if lengths.size > 50 else 1


def lattice_step_N(series: Series) -> float:
    """Step of the readings' lattice, 0 where there is none that is coarser than a millionth of their range [N]."""
    readings = series.reading_N[series.counts]
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


def _running_median(power: Array) -> Array:
    """Median over neighbouring bins, from medians of chunks."""
    chunks = max(power.size // SURROUNDINGS, 1)
    edges = np.linspace(0, power.size, chunks + 1).astype(int)
    medians = np.array([np.median(power[a:b]) for a, b in itertools.pairwise(edges)])
    result: Array = np.interp(np.arange(power.size), 0.5 * (edges[:-1] + edges[1:]), medians)
    return result


def peaks_Hz(series: Series, residual_N: Array, most: int = 3) -> list[float]:
    """Frequencies at which a residual's smoothed spectrum stands out most from its surroundings: modes that ring."""
    size = int(min(residual_N.size // 8, max(256, 4.0 / series.dt_s)))
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


def edges_of_step(series: Series, residual_N: Array) -> tuple[float, int, int] | None:
    """The load step that explains a residual best: its height and the samples where it comes and goes.

    Both edges must be sharp: the means of a short time before and after differ by the height.
    """
    values = np.where(series.counts, residual_N, 0.0)
    total = np.concatenate(([0.0], np.cumsum(values - values.mean())))
    stride = max(1, values.size // 1500)
    coarse = total[::stride]
    size, best = values.size, (0.0, 0, 0)
    for a in range(coarse.size - 1):
        length = (np.arange(a + 1, coarse.size) - a) * float(stride)
        inside = coarse[a + 1 :] - coarse[a]
        gain = inside**2 * size / np.maximum(length * (size - length), 1.0)
        k = int(np.argmax(gain))
        if gain[k] > best[0]:
            best = (float(gain[k]), a * stride, (a + 1 + k) * stride)
    _, first, end = best
    first, end = _sharpened(values, first, 3 * stride), _sharpened(values, end, 3 * stride)
    inside = values[first:end]
    outside = np.concatenate((values[:first], values[end:]))
    if inside.size < 10 or outside.size < 10:
        return None
    height = float(inside.mean() - outside.mean())
    near = max(20, int(0.1 / series.dt_s))
    jumps = [_jump(values, place, near) for place in (first, end) if near < place < size - near]
    if not jumps or any(abs(abs(jump) - abs(height)) > 0.4 * abs(height) for jump, _ in jumps):
        return None
    if any(abs(jump) < EDGE_NOISES * error for jump, error in jumps):
        return None
    return height, first, end


def _sharpened(values: Array, place: int, reach: int) -> int:
    """The sample near a place where the means before and after differ most."""
    if place <= 0 or place >= values.size:
        return int(np.clip(place, 0, values.size))
    low, high = max(1, place - reach), min(values.size - 1, place + reach)
    total = np.concatenate(([0.0], np.cumsum(values)))
    places = np.arange(low, high)
    near = max(5, reach)
    before = np.maximum(places - near, 0)
    after = np.minimum(places + near, values.size)
    means = (total[after] - total[places]) / (after - places) - (total[places] - total[before]) / (places - before)
    return int(places[np.argmax(np.abs(means))])


def _jump(values: Array, place: int, near: int) -> tuple[float, float]:
    """Difference of the means after and before a place, and its standard error."""
    before, after = values[place - near : place - 2], values[place + 2 : place + near]
    error = float(np.sqrt(before.var() / before.size + after.var() / after.size))
    return float(after.mean() - before.mean()), max(error, 1e-12)
