"""Content of a file above half the tick rate. Sampled at the ticks it would appear at a lower frequency (aliasing)."""

import numpy as np

from piezod.arrays import Array

CUTOFF = 0.53  # cutoff of the low-pass filter [cycles per tick]; its transition of 0.06 then begins at one half
HALF_WIDTH = 32  # half of the filter's length [ticks]: Kaiser (1974), transition 0.06 cycles per tick at 60 dB
KAISER_BETA = 5.65  # Kaiser window for 60 dB: 0.1102 (60 - 8.7)
WINDOW = 128  # length of the stretches that are examined [ticks]: a single jump disturbs less than half of one
SHARE = 1e-3  # Amplitude that counts [share of the range]. Three written digits round by half of it
MOST_PER_TICK = 64  # largest number of points per tick that are examined
FEWEST_TICKS = 8  # ticks below which a file is not examined: its ends are corners, and they make up too much of it
BLOCK = 2**14  # ticks that are filtered together


def folding_amplitude(positions: Array, values: Array) -> tuple[float, float]:
    """Amplitude of content above half the tick rate, and its place [ticks]; (0, 0) where there is none.

    A stretch of `WINDOW` ticks holds such content under two conditions. A high-pass filter passes it; and in more than
    half of the stretch the file differs from a line between the ticks. So jumps and corners do not count, and neither
    does a tone below half the tick rate.

    Parameters
    ----------
    positions
        Time of the rows [ticks], never falling, shape (N,).
    values
        Values of the rows, shape (N,).
    """
    steps = np.diff(positions)
    rising = steps[steps > 0.0]
    if positions[-1] < FEWEST_TICKS or np.median(rising) > 0.999:
        return 0.0, 0.0  # no tone above half the tick rate fits between the rows
    step = max(_row_step(rising), 1.0 / MOST_PER_TICK)
    ticks = int(positions[-1]) + 1
    best = (0.0, 0.0)
    for start in range(0, ticks, BLOCK):
        best = max(best, _worst_window(positions, values, start, min(start + BLOCK, ticks), step))
    return best if best[0] > SHARE * float(np.ptp(values)) else (0.0, 0.0)


def _row_step(rising: Array) -> float:
    """Step of evenly spaced rows, else the median step [ticks]."""
    mean, median = float(rising.mean()), float(np.median(rising))
    return mean if np.abs(rising - mean).max() < 0.01 * mean else median


def _worst_window(positions: Array, values: Array, start: int, stop: int, step: float) -> tuple[float, float]:
    """Largest amplitude of a window in a block of ticks, and its place."""
    grid = step * np.arange(np.floor((start - HALF_WIDTH) / step), np.ceil((stop + HALF_WIDTH) / step) + 1)
    signal = np.interp(grid, positions, values)
    high = np.abs(signal - _low_pass(signal, step))
    ticks = np.arange(start - HALF_WIDTH - 1, stop + HALF_WIDTH + 2, dtype=np.float64)
    between = np.abs(signal - np.interp(grid, ticks, np.interp(ticks, positions, values)))
    off_ticks = np.abs(grid - np.rint(grid)) > step / 10.0  # on a tick both curves are equal
    best = (0.0, 0.0)
    for first in range(start, max(stop - WINDOW, start) + 1, WINDOW // 2):
        window = slice(*np.searchsorted(grid, (first, min(first + WINDOW, stop))))
        counted = off_ticks[window]
        if np.count_nonzero(counted) > 2:
            amplitude = min(float(np.median(curve[window][counted])) for curve in (high, between))
            best = max(best, (amplitude, float(first)))
    return best


def _low_pass(signal: Array, step: float) -> Array:
    """The signal below half the tick rate, by a windowed sinc of unit gain at 0."""
    half = int(HALF_WIDTH / step)
    offset = step * np.arange(-half, half + 1)
    kernel = np.sinc(2.0 * CUTOFF * offset) * np.kaiser(offset.size, KAISER_BETA)
    size = 2 ** int(np.ceil(np.log2(signal.size + kernel.size)))
    full = np.fft.irfft(np.fft.rfft(signal, size) * np.fft.rfft(kernel / kernel.sum(), size), size)
    return full[half:][: signal.size]
