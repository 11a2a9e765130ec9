"""Commands of the records: a slow record for the identification, and mixed work for the other recordings.

Every record begins at rest at 0 V. Mixed work is a chain of pieces of 1.5 to 8 s. Kind, range and speed of every piece
are drawn at random. Short ramps join the pieces.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant.amplifier import rate_limited
from firmware_sim.concealed.plant.arrays import Array

FASTEST_HZ = 40.0  # of a periodic piece
SAMPLES_PER_PERIOD = 12.0  # at least
FINE_RATE_HZ = 6000.0  # aim for the fine grid
FEWEST_SUBSTEPS, MOST_SUBSTEPS = 3, 16
SETTLING_S = 1.0  # simulated beyond the end of a record, for readings with a late clock


@dataclass(frozen=True)
class Drive:
    """Commands of one record.

    Parameters
    ----------
    voltage_V
        Commands, shape (n,) [V].
    rate_Hz
        Rate of commands and readings [1/s].
    held
        True: a command is held until the next. False: the voltage runs straight from one command to the next.
    late
        Time from a command to its reading [samples], 0 to 1; 0 unless `held`.
    temperature_C
        Temperature of the bench at each command, shape (n,) [degC].
    """

    voltage_V: Array
    rate_Hz: float
    held: bool
    late: float
    temperature_C: Array

    @property
    def substeps(self) -> int:
        """Steps of the fine grid per sample."""
        return int(np.clip(round(FINE_RATE_HZ / self.rate_Hz), FEWEST_SUBSTEPS, MOST_SUBSTEPS))

    @property
    def fine_s(self) -> float:
        """Step of the fine grid [s]."""
        return 1.0 / (self.rate_Hz * self.substeps)

    @property
    def positions(self) -> Array:
        """Positions of the readings [steps of the fine grid], shape (n,)."""
        whole = np.arange(self.voltage_V.size) * self.substeps + round(self.late * self.substeps)
        return whole.astype(np.float64)

    @property
    def time_s(self) -> Array:
        """Time of each command, shape (n,) [s]."""
        return np.arange(self.voltage_V.size) / self.rate_Hz

    def fine(self, values: Array) -> Array:
        """Values at the samples, interpolated linearly to the fine grid and continued beyond the end."""
        points = np.arange(self._fine_points()) / self.substeps
        return np.interp(points, np.arange(values.size), values)

    def fine_voltage_V(self) -> Array:
        """Input of the amplifier on the fine grid [V]."""
        if not self.held:
            return self.fine(self.voltage_V)
        return self.voltage_V[np.minimum(np.arange(self._fine_points()) // self.substeps, self.voltage_V.size - 1)]

    def _fine_points(self) -> int:
        return self.voltage_V.size * self.substeps + round(SETTLING_S / self.fine_s)


def identification_voltage(rng: np.random.Generator, reach_V: float, rate_Hz: float, duration_s: float) -> Array:
    """Slow commands: virgin rise, triangles of varying peak, minor loops, reversals and holds, shape (n,) [V].

    Parameters
    ----------
    rng
        Source of the random draws.
    reach_V
        Highest voltage [V], above 0.
    rate_Hz
        Sample rate [Hz].
    duration_s
        Duration of the record [s].
    """
    slowest, quickest = reach_V / rng.uniform(6.0, 10.0), reach_V / rng.uniform(1.5, 3.0)
    levels = [0.0, 0.0, *_virgin_rise(rng), 0.0, 1.0, 0.0]
    times = _times(rng, levels, reach_V, slowest, quickest)
    while times[-1] < duration_s:
        more = _identification_piece(rng)
        added = _times(rng, [levels[-1], *more], reach_V, slowest, quickest)
        levels += more
        times += [times[-1] + t for t in added[1:]]
    time_s = np.arange(round(duration_s * rate_Hz)) / rate_Hz
    return reach_V * np.interp(time_s, times, levels)


def mixed_work(
    rng: np.random.Generator, reach_V: float, rate_Hz: float, duration_s: float, most_V_per_s: float
) -> Array:
    """Mixed work from rest over most of the range, with rates up to `most_V_per_s`, shape (n,) [V].

    Parameters
    ----------
    rng, reach_V, rate_Hz, duration_s
        As in `identification_voltage`.
    most_V_per_s
        Highest rate of change [V/s], above 0.
    """
    kinds = tuple(PIECES)
    share = rng.dirichlet(np.full(len(kinds), 2.0)) + 0.04
    share /= share.sum()
    samples = round(duration_s * rate_Hz)
    parts = [np.zeros(round(rng.uniform(0.2, 1.0) * rate_Hz))]
    total, last = parts[0].size, 0.0
    while total < samples:
        kind = kinds[int(rng.choice(len(kinds), p=share))]
        count = round(rng.uniform(1.5, 8.0) * rate_Hz)
        piece = reach_V * PIECES[kind](rng, np.arange(count) / rate_Hz, rate_Hz).clip(0.0, 1.0)
        join = np.linspace(last, piece[0], round(rng.uniform(0.05, 0.6) * rate_Hz) + 2)[1:-1]
        parts += [join, piece]
        total += join.size + piece.size
        last = float(piece[-1])
    return rate_limited(np.concatenate(parts)[:samples], most_V_per_s, 1.0 / rate_Hz)


def temperature(rng: np.random.Generator, duration_s: float, rate_Hz: float) -> Array:
    """Temperature of the bench: a slow random walk, in half of the records with one pulse, shape (n,) [degC].

    Parameters
    ----------
    rng
        Source of the random draws.
    duration_s, rate_Hz
        Duration of the record [s] and sample rate [Hz].
    """
    time_s = np.arange(round(duration_s * rate_Hz)) / rate_Hz
    knots = np.linspace(0.0, duration_s, int(rng.integers(5, 10)))
    walk = np.cumsum(rng.normal(0.0, 1.0, knots.size))
    shape = _smooth_through(time_s, knots, walk)
    if rng.random() < 0.5:
        start_s = rng.uniform(0.1, 0.7) * duration_s
        since = np.maximum(time_s - start_s, 0.0)
        rise_s = rng.uniform(0.05, 0.2) * duration_s
        shape += rng.normal(0.0, 2.0) * (since / rise_s) * np.exp(1.0 - since / rise_s)
    result: Array = rng.uniform(19.0, 27.0) + rng.uniform(0.8, 5.0) * (shape - shape[0]) / max(np.ptp(shape), 1e-9)
    return result


def _virgin_rise(rng: np.random.Generator) -> list[float]:
    """Corner levels of the first rise, relative to the range: straight, or with holds on the way."""
    if rng.random() < 0.4:
        return [1.0]
    treads = np.sort(rng.uniform(0.1, 0.95, int(rng.integers(2, 6))))
    return [*np.repeat(treads, 2).tolist(), 1.0]


def _identification_piece(rng: np.random.Generator) -> list[float]:
    """Corner levels of triangles, minor loops or reversals, relative to the range; a repeated level is a hold."""
    kind = rng.integers(4)
    if kind == 0:
        peaks = np.sort(rng.uniform(0.2, 1.0, int(rng.integers(2, 5))))[:: int(rng.choice([1, -1]))]
        return [level for peak in peaks.tolist() for level in (peak, 0.0)]
    if kind == 1:
        half = rng.uniform(0.04, 0.2)
        bias = rng.uniform(half, 1.0 - half)
        return [*([bias + half, bias - half] * int(rng.integers(2, 4))), bias]
    if kind == 2:
        top = rng.uniform(0.6, 1.0)
        return [level for depth in rng.uniform(0.1, 0.9, 3).tolist() for level in (top, top * depth)]
    ends = rng.uniform(0.0, 1.0, int(rng.integers(3, 7))).tolist()
    held = int(rng.integers(len(ends)))
    return [*ends[: held + 1], *ends[held:]]


def _times(
    rng: np.random.Generator, levels: Sequence[float], reach_V: float, slowest: float, quickest: float
) -> list[float]:
    """Times of the corners [s]; speeds are drawn between two limits [V/s], a repeated level lasts 0.5 to 3 s."""
    travel = reach_V * np.abs(np.diff(levels))
    speed = np.exp(rng.uniform(np.log(slowest), np.log(quickest), travel.size))
    lasts = np.where(travel > 0.0, travel / speed, rng.uniform(0.5, 3.0, travel.size))
    return [0.0, *np.cumsum(np.maximum(lasts, 1e-3)).tolist()]


def _smooth_through(time_s: Array, knots: Array, values: Array) -> Array:
    """Smooth curve near the values at the knots: linear interpolation, averaged over the distance of two knots."""
    straight = np.interp(time_s, knots, values)
    width = max(1, int(time_s.size / knots.size))
    kernel = np.hanning(width + 2)
    padded = np.pad(straight, (kernel.size // 2, kernel.size - 1 - kernel.size // 2), mode="edge")
    # The kernel is as long as a tenth of the record; a Fourier transform is the fastest way.
    size = 1 << int(np.ceil(np.log2(padded.size + kernel.size)))
    spectrum = np.fft.rfft(padded, size) * np.fft.rfft(kernel / kernel.sum(), size)
    return np.fft.irfft(spectrum, size)[kernel.size - 1 : kernel.size - 1 + time_s.size]


def _range(rng: np.random.Generator, least: float = 0.05) -> tuple[float, float]:
    """Draw middle and half width of a piece, relative to the reach."""
    half = 0.5 * rng.uniform(least, 1.0)
    return rng.uniform(half, 1.0 - half), half


def _frequency_Hz(rng: np.random.Generator, rate_Hz: float, slowest_Hz: float = 0.2) -> float:
    """Draw the frequency of a periodic piece [Hz]."""
    fastest = min(FASTEST_HZ, rate_Hz / SAMPLES_PER_PERIOD)
    return float(np.exp(rng.uniform(np.log(slowest_Hz), np.log(fastest))))


def _sine(rng: np.random.Generator, t: Array, rate_Hz: float) -> Array:
    middle, half = _range(rng)
    f = _frequency_Hz(rng, rate_Hz)
    result: Array = middle + half * min(1.0, (3.0 / f) ** 0.5) * np.sin(
        2.0 * np.pi * f * t + rng.uniform(0.0, 2.0 * np.pi)
    )
    return result


def _triangles(rng: np.random.Generator, t: Array, rate_Hz: float) -> Array:
    middle, half = _range(rng)
    f = _frequency_Hz(rng, rate_Hz)
    wave = 2.0 * np.abs(2.0 * ((f * t + rng.uniform()) % 1.0) - 1.0) - 1.0
    fade = 1.0 - rng.uniform(0.0, 0.6) * t / t[-1]
    result: Array = middle + half * min(1.0, (3.0 / f) ** 0.5) * fade * wave
    return result


def _steps(rng: np.random.Generator, t: Array, rate_Hz: float) -> Array:
    del rate_Hz
    lasts = rng.uniform(0.08, 0.8, 200)
    levels = rng.uniform(0.0, 1.0, 201)
    return levels[np.searchsorted(np.cumsum(lasts), t)]


def _staircase(rng: np.random.Generator, t: Array, rate_Hz: float) -> Array:
    del rate_Hz
    tread_s = rng.uniform(0.4, 2.5)
    height = rng.uniform(0.05, 0.35) * rng.choice([1.0, -1.0])
    level = rng.uniform() + height * np.floor(t / tread_s)
    result: Array = 1.0 - np.abs(level % 2.0 - 1.0)
    return result


def _multisine(rng: np.random.Generator, t: Array, rate_Hz: float) -> Array:
    middle, half = _range(rng, 0.15)
    top = _frequency_Hz(rng, rate_Hz, 2.0)
    f = rng.uniform(0.1, top, int(rng.integers(6, 25)))
    wave = (np.sin(2.0 * np.pi * np.outer(t, f) + rng.uniform(0.0, 2.0 * np.pi, f.size)) / (1.0 + f) ** 0.5).sum(axis=1)
    result: Array = middle + half * wave / np.abs(wave).max()
    return result


def _ramps(rng: np.random.Generator, t: Array, rate_Hz: float) -> Array:
    del rate_Hz
    lasts = np.exp(rng.uniform(np.log(0.05), np.log(1.5), 300))
    return np.interp(t, np.cumsum(lasts), rng.uniform(0.0, 1.0, 300))


def _chirp(rng: np.random.Generator, t: Array, rate_Hz: float) -> Array:
    middle, half = _range(rng)
    low, high = 0.3, _frequency_Hz(rng, rate_Hz, 3.0)
    phase = low * t + 0.5 * (high - low) * t * t / t[-1]
    result: Array = middle + half * np.sin(2.0 * np.pi * phase) * (1.0 + t / t[-1] * high / 4.0) ** -0.5
    return result


PIECES: dict[str, Callable[[np.random.Generator, Array, float], Array]] = {
    "sine": _sine,
    "triangles": _triangles,
    "steps": _steps,
    "staircase": _staircase,
    "multisine": _multisine,
    "ramps": _ramps,
    "chirp": _chirp,
}
