"""Commands of work as different benches do it, relative to the range.

- `mixed`: `drives.mixed_work`;
- `press strokes`: rest, approach, fast press, hold and release, again and again, with a peak drawn for each stroke;
- `load spectrum`: blocks of sines whose amplitude, mean and number are drawn, as fatigue benches run them;
- `broadband`: periodic random-phase multisine of two exact periods, or filtered noise.

Every record begins at rest at 0. Its first samples lead to the state in which some benches begin to write.
"""

import numpy as np

from firmware_sim.concealed.plant.amplifier import rate_limited
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import mixed_work
from firmware_sim.concealed.plant.identification_drives import Commands, Draw, eased, rest

BROADBAND_TOP = (0.005, 0.2)  # highest frequency of broadband work [sample rate]
LEAD_S = (1.0, 8.0)  # of work without a state to begin in
MOST_LEAD = 0.2  # of a record


def driven_work(
    kind: str, rng: np.random.Generator, rate_Hz: float, duration_s: float, most_ranges_per_s: float
) -> Commands:
    """Commands of one kind of work, with a limited rate of change where the work is not broadband.

    Parameters
    ----------
    kind
        One of `WORKS`.
    rng
        Source of the random draws.
    rate_Hz, duration_s
        Sample rate [Hz] and duration [s] of the record.
    most_ranges_per_s
        Highest rate of change [1/s], above 0. Broadband work stays periodic, so it is not limited.
    """
    drawn = WORKS[kind](rng, rate_Hz, duration_s)
    if kind == "broadband" or not np.isfinite(most_ranges_per_s):
        return drawn
    return Commands(rate_limited(drawn.levels, most_ranges_per_s, 1.0 / rate_Hz), drawn.lead)


def _mixed(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    return Commands(mixed_work(rng, 1.0, rate_Hz, duration_s, np.inf), _lead(rng, rate_Hz, duration_s))


def _press_strokes(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    """Strokes with the durations of one bench, each varied by up to a fifth, and a peak drawn for each."""
    seconds = np.exp(rng.uniform(np.log([0.2, 0.1, 0.004, 0.05, 0.02]), np.log([1.0, 0.6, 0.06, 0.8, 0.2])))
    touch, bottom, smooth = rng.uniform(0.15, 0.4), rng.uniform(0.0, 0.06), bool(rng.random() < 0.5)
    least = rng.uniform(0.4, 0.8)
    most = rng.uniform(least + 0.15, 1.0)
    samples = round(duration_s * rate_Hz)
    parts, total = [rest(rng, rate_Hz)], 0
    while total < samples:
        peak = rng.uniform(least, most)
        counts = np.maximum(1, np.round(seconds * rng.uniform(0.8, 1.2, seconds.size) * rate_Hz)).astype(int)
        corners = (bottom, bottom, touch, peak, peak, bottom)
        parts += [
            eased(a, b, count) if smooth else np.linspace(a, b, count, endpoint=False)
            for a, b, count in zip(corners, corners[1:], counts.tolist(), strict=False)
        ]
        total += int(counts.sum())
    return Commands(_joined(parts, samples, rate_Hz), _lead(rng, rate_Hz, duration_s))


def _load_spectrum(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    """Many small cycles and few large ones; large cycles are slower where the bench keeps its speed."""
    samples = round(duration_s * rate_Hz)
    frequency_Hz = float(np.exp(rng.uniform(np.log(1.0), np.log(min(20.0, rate_Hz / 25.0)))))
    slower, mean = rng.uniform(0.0, 1.0), rng.uniform(0.35, 0.65)
    parts, total = [rest(rng, rate_Hz)], 0
    while total < samples:
        half = float(np.clip(0.2 * rng.weibull(1.3), 0.02, 0.49))
        middle = float(np.clip(mean + rng.normal(0.0, 0.12), half, 1.0 - half))
        period = max(8, round(rate_Hz / frequency_Hz * max(1.0, half / 0.1) ** slower))
        cycles = min(1 + round(rng.exponential(8.0)), max(1, round(5.0 * rate_Hz / period)))
        last = float(parts[-1][-1])
        parts.append(eased(last, middle, max(2, round(period * rng.uniform(0.5, 1.5)))))
        parts.append(middle + half * np.sin(2.0 * np.pi * np.arange(cycles * period) / period))
        total += parts[-1].size + parts[-2].size
    return Commands(_joined(parts, samples, rate_Hz), _lead(rng, rate_Hz, duration_s))


def _broadband(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    """Rest, a smooth rise, then two equal periods of a multisine, or noise that does not repeat."""
    begin = rest(rng, rate_Hz)
    rise = round(rng.uniform(0.2, 0.6) * rate_Hz)
    periods = 2 if rng.random() < 0.5 else 1
    period = (round(duration_s * rate_Hz) - begin.size - rise) // periods
    half = 0.5 * rng.uniform(0.3, 1.0)
    middle = rng.uniform(half, 1.0 - half)
    wave = np.tile(_band_limited(rng, period, noise=periods == 1), periods)
    levels: Array = np.clip(middle + half * wave, 0.0, 1.0)
    return Commands(np.concatenate((begin, eased(0.0, float(levels[0]), rise), levels)), begin.size + rise)


def _band_limited(rng: np.random.Generator, count: int, *, noise: bool) -> Array:
    """One period of a random signal, shape (count,): a multisine within -1 to 1, or noise of a third of that rms."""
    top = float(np.exp(rng.uniform(*np.log(BROADBAND_TOP))))
    frequency = np.fft.rfftfreq(count)
    size = (frequency <= top).astype(float) if rng.random() < 0.5 else (frequency <= top) / np.sqrt(frequency + 1e-4)
    size[0] = 0.0
    if noise:
        size = size * rng.rayleigh(1.0, size.size)
    wave = np.fft.irfft(size * np.exp(2j * np.pi * rng.uniform(size=size.size)), count)
    result: Array = wave / (3.0 * wave.std() if noise else np.abs(wave).max())
    return result


def _joined(parts: list[Array], samples: int, rate_Hz: float) -> Array:
    """Parts in order, with a straight rise of 50 ms from the rest to the second, shape (samples,)."""
    rise = np.linspace(0.0, parts[1][0], max(2, round(0.05 * rate_Hz)))[1:-1]
    return np.concatenate((parts[0], rise, *parts[1:]))[:samples]


def _lead(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> int:
    return round(min(rng.uniform(*LEAD_S), MOST_LEAD * duration_s) * rate_Hz)


WORKS: dict[str, Draw] = {
    "mixed": _mixed,
    "press strokes": _press_strokes,
    "load spectrum": _load_spectrum,
    "broadband": _broadband,
}
