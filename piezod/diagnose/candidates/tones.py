"""Tones from outside, mains hum and vibration: estimated with slow amplitude and phase, and subtracted from readings.

The frequency of the mains and the amplitude of a machine change slowly. A sine of constant frequency and amplitude
would leave a residual that hides weaker effects. The estimate takes a band of a third of a hertz around the tone.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.candidates.direct import Line, lines
from piezod.diagnose.candidates.starts import within_ranges
from piezod.effects import EFFECTS, mains_hum, vibration
from piezod.effects.mains_hum import HARMONICS
from piezod.estimation.recordings.series import Series

Complex = NDArray[np.complex128]

HUM, VIBRATION = mains_hum.EFFECT.name, vibration.EFFECT.name  # the effects that this test finds

WINDOW_S = 3.0  # length of the Hann window for amplitude and phase; its band is a third of a hertz
MOST_OF_RECORDING = 0.25  # largest length of the window, relative to the recording
MAINS_HZ, MAINS_WITHIN_HZ = (50.0, 60.0), 0.6
MACHINE_HZ = 0.1  # frequency difference below which lines of two recordings belong to one machine
LOWEST_HZ, SEPARATE_HZ = 2.0, 1.0  # least frequency of a sampled harmonic, and least distance of separate harmonics
ROUNDS = 4  # alternating estimates of harmonics that are near each other
RIDGE = 0.02  # relative ridge for a carrier that coincides with its conjugate
SWINGS = 0.5  # relative change of amplitude with the command above which a line comes from a gain, not from outside
BAND = 0.99  # share of the command's power in the band around such a line in which other lines belong to it
BREATHING_SHARE = 0.8  # share of the amplitude's variance that one period must explain
BREATHS, LONGEST_BREATH, DEEPEST = 60, 1.5, 0.9  # periods tried, the longest over the recording; largest depth
MULTIPLES, MULTIPLE_HZ = 20, 0.3  # multiples of the mains frequency that are no other machine, and their tolerance


@dataclass(frozen=True)
class Tone:
    """Tone in one recording."""

    name: str  # mains_hum or vibration
    number: int  # of the recording
    values: dict[str, float]  # parameters of the effect, averaged over the recording
    signal_N: Array  # tone with its harmonics, shape (N,) [N]


def without_tones(series: Sequence[Series], subtracted: Sequence[Tone]) -> list[Series]:
    """Recordings with tones subtracted from their readings."""
    result = list(series)
    for tone in subtracted:
        recording = result[tone.number]
        result[tone.number] = replace(recording, reading_N=recording.reading_N - tone.signal_N)
    return result


def with_tones(series: Sequence[Series], added: Sequence[Tone]) -> list[Series]:
    """Recordings with tones added to their readings again."""
    return without_tones(series, [replace(tone, signal_N=-tone.signal_N) for tone in added])


def tones(series: Sequence[Series], residuals: Sequence[Array], known: Sequence[Tone]) -> list[list[Tone]]:
    """Tones of the diagnosed recordings, grouped by machine, the most powerful first.

    A group also contains the tones of its machine in the identification recordings, which must be subtracted too.

    `residuals` have shape (N,) each [N]. The effects of subtracted tones (`known`) are not proposed again.
    """
    names = {tone.name for tone in known}
    hum_Hz = [tone.values["frequency_Hz"] for tone in known if tone.name == HUM]
    groups: list[list[Tone]] = []
    for number in sorted(range(len(series)), key=lambda k: series[k].role != "recording"):
        for tone in _tones_of(number, series[number], residuals[number], hum_Hz):
            known_group = next((group for group in groups if _is_same_machine(group, tone)), None)
            if known_group is not None:
                known_group.append(tone)
            elif tone.name not in names and series[number].role == "recording":
                groups.append([tone])
    return sorted(groups, key=lambda group: -sum(float(tone.signal_N @ tone.signal_N) for tone in group))


def reestimated_tones(series: Sequence[Series], residuals: Sequence[Array], known: Sequence[Tone]) -> list[Tone]:
    """Subtracted tones, estimated again from new residuals.

    `residuals`: residuals of the recordings without the tones, shape (N,) each [N].
    """
    remainders, estimates = [residual.copy() for residual in residuals], []
    for tone in known:
        estimate = _hum if tone.name == HUM else _vibration
        with_tone_N = remainders[tone.number] + tone.signal_N
        estimates.append(estimate(tone.number, series[tone.number], with_tone_N, tone.values["frequency_Hz"]))
        remainders[tone.number] = with_tone_N - estimates[-1].signal_N
    return estimates


def _is_same_machine(group: Sequence[Tone], tone: Tone) -> bool:
    first = group[0]
    within_Hz = MAINS_WITHIN_HZ if tone.name == HUM else MACHINE_HZ
    near = abs(first.values["frequency_Hz"] - tone.values["frequency_Hz"]) < within_Hz
    return first.name == tone.name and near and tone.number not in {known.number for known in group}


def _tones_of(number: int, series: Series, residual_N: Array, hum_Hz: Sequence[float]) -> list[Tone]:
    peaks = lines(series, residual_N)
    mains = [line for line in peaks if min(abs(line.frequency_Hz - f) for f in MAINS_HZ) < MAINS_WITHIN_HZ]
    hum = [_hum(number, series, residual_N, mains[0].frequency_Hz)] if mains else []
    hum_Hz = [*hum_Hz, *(line.frequency_Hz for line in mains[:1])]
    others = [line for line in peaks if not any(_is_multiple(line.frequency_Hz, f, series.dt_s) for f in hum_Hz)]
    steady = _steady_lines(series, residual_N, others)
    return hum + [_vibration(number, series, residual_N, line.frequency_Hz) for line in steady]


def _steady_lines(series: Series, residual_N: Array, peaks: Sequence[Line]) -> list[Line]:
    """Lines whose amplitude does not depend on the command, and that are no sidebands of a line that does.

    If the amplitude depends strongly on the command, the sidebands exceed the line midway between them.
    """
    band_Hz = _command_band_Hz(series) if peaks else 0.0
    pairs = itertools.combinations_with_replacement([line.frequency_Hz for line in peaks], 2)
    centres_Hz = {0.5 * (a + b) for a, b in pairs if abs(a - b) <= 2.0 * band_Hz}
    tones_N = [(f, *swing_with_command(series, residual_N, f)) for f in centres_Hz]
    depth = _depth(series)
    swinging = [(f, np.hypot(steady, swing)) for f, steady, swing in tones_N if swing * depth > SWINGS * steady]
    return [
        line
        for line in peaks
        if not any(abs(line.frequency_Hz - f) <= band_Hz and size_N >= line.amplitude_N for f, size_N in swinging)
    ]


def swing_with_command(series: Series, residual_N: Array, frequency_Hz: float) -> tuple[float, float]:
    """Amplitude of a tone, and its change when the command changes by its standard deviation [N].

    A tone from outside does not depend on the command; an oscillating gain does.
    """
    u = series.command_V[series.counts]
    moved = (u - u.mean()) / max(float(u.std()), 1e-300)
    carrier = np.exp(2j * np.pi * frequency_Hz * series.time_s[series.counts])
    columns = np.column_stack([part for wave in (carrier, moved * carrier) for part in (wave.real, wave.imag)])
    steady_N, swing_N = np.linalg.lstsq(columns, residual_N[series.counts], rcond=None)[0].reshape(2, 2)
    return float(np.hypot(*steady_N)), float(np.hypot(*swing_N))


def _depth(series: Series) -> float:
    """Distance from the mean command to the lowest one, at which a gain has the least effect [standard deviations]."""
    u = series.command_V[series.counts]
    return float((u.mean() - u.min()) / max(float(u.std()), 1e-300))


def _command_band_Hz(series: Series) -> float:
    """Frequency below which nearly all of the command's power lies: the distance of sidebands from their line [Hz]."""
    power = np.abs(np.fft.rfft((series.command_V - series.command_V.mean()) * np.hanning(series.command_V.size))) ** 2
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return float(np.searchsorted(share, BAND) + 1) / series.duration_s


def _is_multiple(frequency_Hz: float, base_Hz: float, dt_s: float) -> bool:
    """Whether a frequency is an aliased multiple of another one."""
    return any(abs(_aliased(k * base_Hz, dt_s) - frequency_Hz) < MULTIPLE_HZ for k in range(1, MULTIPLES + 1))


def _aliased(frequency_Hz: float, dt_s: float) -> float:
    """Apparent frequency after sampling [Hz]."""
    return abs(frequency_Hz - round(frequency_Hz * dt_s) / dt_s)


def _hum(number: int, series: Series, residual_N: Array, frequency_Hz: float) -> Tone:
    envelope, carrier = _envelope_and_carrier(series, residual_N, frequency_Hz)
    values = _mean_values(HUM, series, envelope, frequency_Hz)
    signal_N = 2.0 * (envelope * carrier).real
    unit = carrier * np.exp(1j * np.angle(envelope))
    sampled_Hz = {h: _aliased(h * frequency_Hz, series.dt_s) for h in (1, *HARMONICS)}
    parts = {h: np.zeros(unit.size, dtype=np.complex128) for h in HARMONICS if sampled_Hz[h] >= LOWEST_HZ}
    for round_ in range(ROUNDS):
        for h in parts:
            near = any(abs(sampled_Hz[h] - sampled_Hz[k]) < SEPARATE_HZ for k in (1, *parts) if k != h)
            if round_ == 0 or near:  # neighbours share a band: alternating rounds separate them
                more = _amplitude(series, residual_N - signal_N, unit**h)  # in phase with the fundamental
                parts[h] += more
                signal_N += 2.0 * (more * unit**h).real
    for h, part in parts.items():
        mean = complex(np.mean(part[series.counts])) * np.exp(-0.5j * np.pi * h) / (0.5 * values["amplitude_N"])
        values[f"cosine_{h}"], values[f"sine_{h}"] = mean.real, -mean.imag
    return Tone(HUM, number, within_ranges(EFFECTS[HUM], values), signal_N)


def _vibration(number: int, series: Series, residual_N: Array, frequency_Hz: float) -> Tone:
    envelope, carrier = _envelope_and_carrier(series, residual_N, frequency_Hz)
    values = _mean_values(VIBRATION, series, envelope, frequency_Hz)
    values |= _breathing(series, 2.0 * np.abs(envelope))
    return Tone(VIBRATION, number, within_ranges(EFFECTS[VIBRATION], values), 2.0 * (envelope * carrier).real)


def _envelope_and_carrier(series: Series, residual_N: Array, frequency_Hz: float) -> tuple[Complex, Complex]:
    """Slow complex amplitude at a frequency, and its carrier, shape (N,) each."""
    carrier = np.exp(2j * np.pi * frequency_Hz * series.time_s)
    return _amplitude(series, residual_N, carrier), carrier


def _amplitude(series: Series, residual_N: Array, carrier: Complex) -> Complex:
    """Slow complex amplitude c of c carrier + conjugate, by least squares under the window, shape (N,).

    Near half the sampling rate the conjugate lies in the same band, such as that of 100 Hz at 200 samples/s.
    """
    back: Complex = np.conj(carrier)
    along, mirror = _smoothed(series, residual_N * back), _smoothed(series, back * back)
    own: Array = 1.0 + RIDGE * np.abs(mirror) ** 2  # coinciding carrier and conjugate share the amplitude
    result: Complex = (own * along - mirror * np.conj(along)) / (own**2 - np.abs(mirror) ** 2)
    return result


def _smoothed(series: Series, values: Complex) -> Complex:
    """Mean under a Hann window around every sample, over readings that count."""
    length_s = min(WINDOW_S, MOST_OF_RECORDING * series.duration_s)
    window = np.hanning(max(int(length_s / series.dt_s), 3) + 2)
    size = 1 << int(np.ceil(np.log2(values.size + window.size)))
    kernel = np.fft.fft(window, size)
    counts = series.counts.astype(np.float64)
    sums = np.fft.ifft(np.fft.fft(np.where(series.counts, values, 0.0), size) * kernel)
    norms = np.fft.ifft(np.fft.fft(counts, size) * kernel).real
    middle = slice(window.size // 2, window.size // 2 + values.size)
    result: Complex = sums[middle] / np.maximum(norms[middle], 1e-9 * window.sum())
    return result


def _mean_values(name: str, series: Series, envelope: Complex, frequency_Hz: float) -> dict[str, float]:
    """Parameters of the effect with the mean frequency, amplitude and phase."""
    known = envelope[series.counts]
    phase, weight = np.unwrap(np.angle(known)), np.abs(known)
    slope, start = np.polyfit(series.time_s[series.counts], phase, 1, w=weight)
    values = {p.name: p.search.starts[0] for p in EFFECTS[name].parameters if not p.search.choices}
    values["frequency_Hz"] = frequency_Hz + float(slope) / (2.0 * np.pi)
    values["amplitude_N"] = 2.0 * float(np.mean(weight))
    values["phase_rad"] = (float(start) + 0.5 * np.pi) % (2.0 * np.pi)  # from a cosine to a sine
    return values


def _breathing(series: Series, amplitude_N: Array) -> dict[str, float]:
    """Parameters of a periodic amplitude; empty if no single period explains most of its variance."""
    time_s, amplitude_N = series.time_s[series.counts], amplitude_N[series.counts]
    few = slice(None, None, max(int(0.1 * WINDOW_S / series.dt_s), 1))
    time_s, amplitude_N = time_s[few], amplitude_N[few]
    power = float(np.var(amplitude_N))
    if power == 0.0:
        return {}
    least, best = 1.0 - BREATHING_SHARE, dict[str, float]()
    for period_s in np.geomspace(WINDOW_S, LONGEST_BREATH * series.duration_s, BREATHS):
        turn = 2.0 * np.pi * time_s / period_s
        columns = np.column_stack((np.ones(turn.size), np.sin(turn), np.cos(turn)))
        mean_N, sine, cosine = np.linalg.lstsq(columns, amplitude_N, rcond=None)[0]
        unexplained = float(np.var(amplitude_N - columns @ (mean_N, sine, cosine))) / power
        depth = float(np.hypot(sine, cosine) / mean_N)
        if unexplained < least and 0.0 < depth < DEEPEST:
            least = unexplained
            best = {
                "amplitude_N": float(mean_N),
                "breathing_depth": depth,
                "breathing_period_s": float(period_s),
                "breathing_phase_rad": float(np.arctan2(cosine, sine)),
            }
    return best
