"""Tones from outside, mains hum and vibration: followed through a recording as they wander, and taken off its readings.

A mains frequency wanders and a machine swells, so a sine of constant frequency and amplitude leaves a remainder that
hides what is weaker. What follows the tone is a band of a third of a hertz around it and nothing else.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.direct import Line, lines
from piezod.diagnose.hypothesis.series import Series
from piezod.effects import EFFECTS
from piezod.effects.mains_hum import HARMONICS

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FOLLOWED_S = 3.0  # half as long a Hann window follows half as narrow a band
SHORTEST_PART = 0.25  # of a recording at most
MAINS_HZ, MAINS_WITHIN_HZ = (50.0, 60.0), 0.6
ALIKE_HZ = 0.1  # lines of two recordings that belong to one machine
LOWEST_HZ, APART_HZ = 2.0, 1.0  # of a harmonic as it appears, from zero and from the others
TURNS = 4  # in which harmonics that appear near each other are told apart
RIDGE = 0.02  # of an amplitude, where carrier and conjugate cannot be told apart
SWINGS = 0.5  # of its amplitude, that it loses or gains where the command is lowest: no tone from outside,
BAND = 0.99  # nor are its neighbours within the band that has so much of the command's power
BREATHED = 0.8  # of the course of an amplitude, that one period must tell
BREATHS, LONGEST_BREATH, DEEPEST = 60, 1.5, 0.9  # periods that are looked at, up to so many recordings long; of a depth
MULTIPLES, MULTIPLE_HZ = 20, 0.3  # of the mains: none of them is another machine


@dataclass(frozen=True)
class Tone:
    """One tone in one recording.

    Parameters
    ----------
    name
        mains_hum or vibration.
    number
        Of the recording.
    values
        Parameters of the effect, at the middle of what wanders.
    heard_N
        The tone with its harmonics as it wanders, shape (N,) [N].
    """

    name: str
    number: int
    values: dict[str, float]
    heard_N: Array


def without_tones(series: Sequence[Series], heard: Sequence[Tone]) -> list[Series]:
    """The recordings with tones taken off their readings."""
    result = list(series)
    for tone in heard:
        one = result[tone.number]
        result[tone.number] = replace(one, reading_N=one.reading_N - tone.heard_N)
    return result


def with_tones(series: Sequence[Series], heard: Sequence[Tone]) -> list[Series]:
    """The recordings with tones put back."""
    return without_tones(series, [replace(tone, heard_N=-tone.heard_N) for tone in heard])


def tones(series: Sequence[Series], residuals: Sequence[Array], known: Sequence[Tone]) -> list[list[Tone]]:
    """Tones in the recordings asked about, those with the most power first; one machine's together.

    Where a machine is heard in what the model was identified on too, that comes after its other tones: left there it
    would drown what is weaker in the recordings.

    Parameters
    ----------
    series, residuals
        Reading less simulation, each shape (N,) [N].
    known
        Those that were taken off already: their effects are not proposed again.
    """
    names = {one.name for one in known}
    hum_Hz = [one.values["frequency_Hz"] for one in known if one.name == "mains_hum"]
    groups: list[list[Tone]] = []
    for number in sorted(range(len(series)), key=lambda k: series[k].role != "recording"):
        for tone in _of(number, series[number], residuals[number], hum_Hz):
            mine = next((group for group in groups if _same_machine(group, tone)), None)
            if mine is not None:
                mine.append(tone)
            elif tone.name not in names and series[number].role == "recording":
                groups.append([tone])
    return sorted(groups, key=lambda group: -sum(float(tone.heard_N @ tone.heard_N) for tone in group))


def heard_again(series: Sequence[Series], residuals: Sequence[Array], known: Sequence[Tone]) -> list[Tone]:
    """Tones that were taken off, followed anew beside what is left by now.

    Parameters
    ----------
    series, residuals
        With the tones off; reading less simulation, each shape (N,) [N].
    known
        The tones.
    """
    left, again = [residual.copy() for residual in residuals], []
    for tone in known:
        follow = _hum if tone.name == "mains_hum" else _vibration
        beside_N = left[tone.number] + tone.heard_N
        again.append(follow(tone.number, series[tone.number], beside_N, tone.values["frequency_Hz"]))
        left[tone.number] = beside_N - again[-1].heard_N
    return again


def _same_machine(group: Sequence[Tone], tone: Tone) -> bool:
    first = group[0]
    within_Hz = MAINS_WITHIN_HZ if tone.name == "mains_hum" else ALIKE_HZ
    near = abs(first.values["frequency_Hz"] - tone.values["frequency_Hz"]) < within_Hz
    return first.name == tone.name and near and tone.number not in {one.number for one in group}


def _of(number: int, series: Series, residual_N: Array, hum_Hz: Sequence[float]) -> list[Tone]:
    seen = lines(series, residual_N)
    mains = [one for one in seen if min(abs(one.frequency_Hz - f) for f in MAINS_HZ) < MAINS_WITHIN_HZ]
    found = [_hum(number, series, residual_N, mains[0].frequency_Hz)] if mains else []
    hum_Hz = [*hum_Hz, *(one.frequency_Hz for one in mains[:1])]
    strange = [one for one in seen if not any(_multiple(one.frequency_Hz, f, series.dt_s) for f in hum_Hz)]
    steady = _steady_lines(series, residual_N, strange)
    return found + [_vibration(number, series, residual_N, line.frequency_Hz) for line in steady]


def _steady_lines(series: Series, residual_N: Array, seen: Sequence[Line]) -> list[Line]:
    """Those that do not swing with the command, and are not what one that does has on either side.

    Of a strong swing the sides stand out more than the tone, which is midway between them.
    """
    band_Hz = _command_band_Hz(series) if seen else 0.0
    pairs = itertools.combinations_with_replacement([one.frequency_Hz for one in seen], 2)
    centres_Hz = {0.5 * (a + b) for a, b in pairs if abs(a - b) <= 2.0 * band_Hz}
    tones_N = [(f, *swing_with_command(series, residual_N, f)) for f in centres_Hz]
    deep = _depth(series)
    swinging = [(f, np.hypot(steady, swing)) for f, steady, swing in tones_N if swing * deep > SWINGS * steady]
    return [
        one
        for one in seen
        if not any(abs(one.frequency_Hz - f) <= band_Hz and size_N >= one.amplitude_N for f, size_N in swinging)
    ]


def swing_with_command(series: Series, residual_N: Array, frequency_Hz: float) -> tuple[float, float]:
    """Amplitude of a tone, and by how much it grows or falls when the command moves by its standard deviation [N].

    What comes from outside knows nothing of the command; a gain that swings does.
    """
    u = series.command_V[series.counts]
    moved = (u - u.mean()) / max(float(u.std()), 1e-300)
    carrier = np.exp(2j * np.pi * frequency_Hz * series.time_s[series.counts])
    columns = np.column_stack([part for one in (carrier, moved * carrier) for part in (one.real, one.imag)])
    steady_N, swing_N = np.linalg.lstsq(columns, residual_N[series.counts], rcond=None)[0].reshape(2, 2)
    return float(np.hypot(*steady_N)), float(np.hypot(*swing_N))


def _depth(series: Series) -> float:
    """Standard deviations from the mean of the command to its lowest, where a gain has least to act on."""
    u = series.command_V[series.counts]
    return float((u.mean() - u.min()) / max(float(u.std()), 1e-300))


def _command_band_Hz(series: Series) -> float:
    """Frequency below which nearly all of the command's power is; so far its products lie from a tone that swings."""
    power = np.abs(np.fft.rfft((series.command_V - series.command_V.mean()) * np.hanning(series.command_V.size))) ** 2
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return float(np.searchsorted(share, BAND) + 1) / series.duration_s


def _multiple(frequency_Hz: float, of_Hz: float, dt_s: float) -> bool:
    """Whether it is a multiple of a frequency, as sampling folds them."""
    return any(abs(_folded(k * of_Hz, dt_s) - frequency_Hz) < MULTIPLE_HZ for k in range(1, MULTIPLES + 1))


def _folded(frequency_Hz: float, dt_s: float) -> float:
    """Where a frequency appears in samples."""
    return abs(frequency_Hz - round(frequency_Hz * dt_s) / dt_s)


def _hum(number: int, series: Series, residual_N: Array, frequency_Hz: float) -> Tone:
    envelope, carrier = _followed(series, residual_N, frequency_Hz)
    values = _steady("mains_hum", series, envelope, frequency_Hz)
    heard = 2.0 * (envelope * carrier).real
    unit = carrier * np.exp(1j * np.angle(envelope))
    appear_Hz = {h: _folded(h * frequency_Hz, series.dt_s) for h in (1, *HARMONICS)}
    parts = {h: np.zeros(unit.size, dtype=np.complex128) for h in HARMONICS if appear_Hz[h] >= LOWEST_HZ}
    for turn in range(TURNS):
        for h in parts:
            near = any(abs(appear_Hz[h] - appear_Hz[k]) < APART_HZ for k in (1, *parts) if k != h)
            if turn == 0 or near:  # what is near falls into its band too: in turns each gets its own
                more = _amplitude(series, residual_N - heard, unit**h)  # its phase goes with the fundamental's
                parts[h] += more
                heard += 2.0 * (more * unit**h).real
    for h, part in parts.items():
        mean = complex(np.mean(part[series.counts])) * np.exp(-0.5j * np.pi * h) / (0.5 * values["amplitude_N"])
        values[f"cosine_{h}"], values[f"sine_{h}"] = mean.real, -mean.imag
    return Tone("mains_hum", number, _inside("mains_hum", values), heard)


def _vibration(number: int, series: Series, residual_N: Array, frequency_Hz: float) -> Tone:
    envelope, carrier = _followed(series, residual_N, frequency_Hz)
    values = _steady("vibration", series, envelope, frequency_Hz)
    values |= _breathing(series, 2.0 * np.abs(envelope))
    return Tone("vibration", number, _inside("vibration", values), 2.0 * (envelope * carrier).real)


def _followed(series: Series, residual_N: Array, frequency_Hz: float) -> tuple[Complex, Complex]:
    """Slow complex amplitude about a frequency, and the carrier that it belongs to."""
    carrier = np.exp(2j * np.pi * frequency_Hz * series.time_s)
    return _amplitude(series, residual_N, carrier), carrier


def _amplitude(series: Series, residual_N: Array, carrier: Complex) -> Complex:
    """Slow complex amplitude c of a carrier in c carrier + its conjugate, by least squares under the window.

    Near half the sampling rate, as the second harmonic of 50 Hz is at 200 Hz, the conjugate falls into the same band.
    """
    back: Complex = np.conj(carrier)
    along, mirror = _smoothed(series, residual_N * back), _smoothed(series, back * back)
    own: Array = 1.0 + RIDGE * np.abs(mirror) ** 2  # where both are one, each gets half
    result: Complex = (own * along - mirror * np.conj(along)) / (own**2 - np.abs(mirror) ** 2)
    return result


def _smoothed(series: Series, values: Complex) -> Complex:
    """Mean under a Hann window about every sample, over readings that count."""
    length_s = min(FOLLOWED_S, SHORTEST_PART * series.duration_s)
    window = np.hanning(max(int(length_s / series.dt_s), 3) + 2)
    size = 1 << int(np.ceil(np.log2(values.size + window.size)))
    kernel = np.fft.fft(window, size)
    counts = series.counts.astype(np.float64)
    sums = np.fft.ifft(np.fft.fft(np.where(series.counts, values, 0.0), size) * kernel)
    norms = np.fft.ifft(np.fft.fft(counts, size) * kernel).real
    middle = slice(window.size // 2, window.size // 2 + values.size)
    result: Complex = sums[middle] / np.maximum(norms[middle], 1e-9 * window.sum())
    return result


def _steady(name: str, series: Series, envelope: Complex, frequency_Hz: float) -> dict[str, float]:
    """Frequency, amplitude and phase that come nearest, as the effect counts them."""
    heard = envelope[series.counts]  # where nothing counts it is nothing
    phase, weight = np.unwrap(np.angle(heard)), np.abs(heard)
    slope, start = np.polyfit(series.time_s[series.counts], phase, 1, w=weight)
    values = {one.name: one.search.starts[0] for one in EFFECTS[name].parameters if not one.search.choices}
    values["frequency_Hz"] = frequency_Hz + float(slope) / (2.0 * np.pi)
    values["amplitude_N"] = 2.0 * float(np.mean(weight))
    values["phase_rad"] = (float(start) + 0.5 * np.pi) % (2.0 * np.pi)  # a cosine's as a sine's
    return values


def _breathing(series: Series, swell_N: Array) -> dict[str, float]:
    """How an amplitude breathes, as the effect counts it; empty where no one period tells most of its course."""
    time_s, swell_N = series.time_s[series.counts], swell_N[series.counts]
    few = slice(None, None, max(int(0.1 * FOLLOWED_S / series.dt_s), 1))
    time_s, swell_N = time_s[few], swell_N[few]
    power = float(np.var(swell_N))
    if power == 0.0:
        return {}
    best: tuple[float, dict[str, float]] = (1.0 - BREATHED, {})
    for period_s in np.geomspace(FOLLOWED_S, LONGEST_BREATH * series.duration_s, BREATHS):
        turn = 2.0 * np.pi * time_s / period_s
        columns = np.column_stack((np.ones(turn.size), np.sin(turn), np.cos(turn)))
        mean_N, sine, cosine = np.linalg.lstsq(columns, swell_N, rcond=None)[0]
        left = float(np.var(swell_N - columns @ (mean_N, sine, cosine))) / power
        depth = float(np.hypot(sine, cosine) / mean_N)
        if left < best[0] and 0.0 < depth < DEEPEST:
            best = (
                left,
                {
                    "amplitude_N": float(mean_N),
                    "breathing_depth": depth,
                    "breathing_period_s": float(period_s),
                    "breathing_phase_rad": float(np.arctan2(cosine, sine)),
                },
            )
    return best[1]


def _inside(name: str, values: dict[str, float]) -> dict[str, float]:
    effect = EFFECTS[name]
    return {
        key: float(np.clip(value, effect.parameter(key).low, effect.parameter(key).high))
        for key, value in values.items()
    }
