"""What stands out of a residual's own colour in time: tones, jumps, bursts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.localisation import colour

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SURE = 1e-3  # family-wise chance with which noise shows a tone or a jump
MOST_TONES, MOST_JUMPS = 6, 4
SLOWEST_CYCLES = 3  # a record
JUMP_LOOKS_S = (0.1, 0.4, 1.6)  # time on either side whose means are compared
FEWEST_LOOKS = 60  # that tell how uneven means are
BURST_SAMPLES = (1, 8, 64, 512)
COARSE = 2.0  # a lattice that is so many noises wide makes patterns of its own


@dataclass(frozen=True)
class Bursts:
    """Stretches with more power than the residual's colour gives.

    Parameters
    ----------
    energy
        Square of the residual in them beyond the usual.
    p
        Family-wise, for the strongest.
    """

    energy: float
    p: float


def tones_Hz(values: Array, dt_s: float) -> list[float]:
    """Frequencies of narrow peaks, the highest first; noise shows one in a thousand records."""
    spectrum = colour.windowed_spectrum(values)
    over = colour.prominence(spectrum, SLOWEST_CYCLES)
    least = np.log(over.size / SURE)
    found: list[int] = []
    for peak in np.argsort(over)[::-1]:
        if over[peak] < least or len(found) == MOST_TONES:
            break
        if all(abs(int(peak) - other) > 3 for other in found):
            found.append(int(peak))
    bin_Hz = 1.0 / (values.size * dt_s)
    return [colour.refined_frequency_Hz(values - values.mean(), dt_s, peak * bin_Hz) for peak in found]


def jumps(values: Array, dt_s: float, lattice: float) -> list[int]:
    """Samples at which the level changes at once, by more than means of its colour do; the surest first.

    Parameters
    ----------
    values
        Residual, shape (N,).
    dt_s
        Spacing of the samples.
    lattice
        Step of the readings, in the residual's unit: smaller jumps are its own.
    """
    total = np.concatenate(([0.0], np.cumsum(values)))
    sure: list[tuple[float, int, int]] = []
    for look_s in (min(JUMP_LOOKS_S[0], values.size * dt_s / (FEWEST_LOOKS + 3)), *JUMP_LOOKS_S[1:]):
        look = max(int(look_s / dt_s), 8)
        stride = max(look // 8, 1)
        at = np.arange(look, values.size - look, stride)
        if at.size * stride < FEWEST_LOOKS * look:
            continue
        change = (total[at + look] - 2.0 * total[at] + total[at - look]) / look
        z = np.abs(change) / max(colour.spread(change), 0.35 * lattice, 1e-12)
        least = np.sqrt(2.0 * np.log(at.size / SURE))
        sure += [(float(z[k] / least), int(at[k]), look) for k in np.flatnonzero(z > least)]
    found: list[tuple[int, int]] = []
    for _, at_k, look in sorted(sure, reverse=True):
        if all(abs(at_k - other) > max(look, wide) for other, wide in found) and len(found) < MOST_JUMPS:
            found.append((at_k, look))
    return [_sharpened(total, at_k, look) for at_k, look in found]


def _sharpened(total: Array, near: int, look: int) -> int:
    """The sample near a jump at which means before and after differ most."""
    places = np.arange(max(near - look // 2, look), min(near + look // 2, total.size - 1 - look))
    if not places.size:
        return near
    change = total[places + look] - 2.0 * total[places] + total[places - look]
    return int(places[np.argmax(np.abs(change))])


def bursts(values: Array, counts: Mask, lattice: float) -> Bursts:
    """Find stretches with more power than the residual's own colour gives.

    Parameters
    ----------
    values
        Residual, shape (N,).
    counts
        Which of them are known, shape (N,).
    lattice
        Step of the readings, in the residual's unit.
    """
    coarse = lattice > COARSE * colour.spread(values)
    news = values if coarse else colour.innovations(values)
    usual = max(colour.spread(news[counts]), 0.5 * lattice if coarse else 0.0, 1e-12)
    known = np.concatenate(([0.0], np.cumsum(counts)))
    total = np.concatenate(([0.0], np.cumsum(np.where(counts, news / usual, 0.0) ** 2)))
    struck, smallest = np.zeros(values.size, bool), 1.0
    for samples in (one for one in BURST_SAMPLES if one <= values.size):
        edges = np.arange(0, values.size + 1, samples)
        n, power = np.diff(known[edges]), np.diff(total[edges])
        p = _tail(power, n, samples, 1.0 if coarse else 0.0)
        p = np.minimum(p * np.count_nonzero(n) * len(BURST_SAMPLES), 1.0)
        smallest = min(smallest, float(p.min()))
        for k in np.flatnonzero(p < SURE):
            struck[edges[k] : edges[k + 1]] = True
    struck &= counts
    usual_power = float(np.mean(values[counts & ~struck] ** 2)) if (counts & ~struck).any() else 0.0
    return Bursts(max(float(np.sum(values[struck] ** 2)) - usual_power * np.count_nonzero(struck), 0.0), smallest)


def _tail(power: Array, n: Array, samples: int, least: float) -> Array:
    """Chance of so much power in so many samples; cube roots are nearly Gaussian, as uneven as the record shows.

    `least` is a mean square that is usual anyway.
    """
    full = n > 0.5 * samples
    width = 2.0 / (9.0 * samples)
    root = np.cbrt(power / np.maximum(n, 1.0))
    middle = float(np.median(root[full])) if full.any() else 1.0
    if samples < 8:
        middle = 1.0 - width
    middle = max(middle, least)
    uneven = max(np.sqrt(width) * max(middle, 1e-12), colour.spread(root[full]) if samples >= 8 else 0.0)
    z = np.where(full, (root - middle) / uneven, 0.0)
    if samples == 1:
        z = np.sqrt(power)
    return _beyond(z)


def _beyond(z: Array) -> Array:
    """Upper tail of a Gaussian, a bound from above for z > 0 (Chernoff), 1 below."""
    result: Array = np.where(z > 0.0, np.exp(-0.5 * np.maximum(z, 0.0) ** 2), 1.0)
    return result
