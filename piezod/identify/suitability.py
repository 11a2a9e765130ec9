"""Whether a recording can tell a model at all: refused, or warned about, in one line with what to record instead."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError
from piezod.operators.play import play_states_run
from piezod.recording import Recording
from piezod.recording.names import unit_of
from piezod.recording.quantities import UNITS

Array = NDArray[np.float64]

FEWEST_SAMPLES = 100
ADVICE = "record triangles from 0 over the whole range (piezod record --excitation varying-triangles)"

PLAUSIBLE = {"V": (5.0, 1500.0, "a piezo amplifier drives"), "N": (0.5, 50_000.0, "a piezo stack gives")}
"""Range of the largest value by unit: the outermost of amplifiers and stacks that are sold."""

RATES_HZ = (0.1, 1e6)
LOOSE, OPPOSITE = 0.3, -0.5
"""Correlations below which the output hardly follows the input, or runs against it."""

QUIET = 10.0
"""Least swing, in standard deviations of the noise."""

ONE_WAY = 0.1
"""Share of its swing that the input must turn back by."""

SLOW = 0.1
"""Share of the drive's power: of triangles it is in their fundamental, of a broadband drive in its slowest tenth."""

LEADS = 0.01
"""Mean opening of a clockwise loop, as share of the output's range, from which on the output leads the input."""

CLEANER = 5.0
"""How many times less noise an input has that was commanded, so that it is no measured force."""

SATURATED = 0.25
"""Share of the input's swing over which the output may stay within a hundredth of its range from the top."""

LOOKED_AT = 2**20
"""Samples that are enough for a statistic, and that are worked on together."""


@dataclass(frozen=True)
class _Pair:
    """Input and output as they are judged.

    Parameters
    ----------
    source, input, output
        For messages: file and columns.
    time_s, u, y
        Shape (N,); y is nan where it is missing.
    """

    source: str
    input: str
    output: str
    time_s: Array
    u: Array
    y: Array

    def refused(self, why: str) -> RecordingError:
        """The error that says so."""
        return RecordingError(f"{self.source}: {why}")

    def some(self) -> tuple[Array, Array]:
        """Input and output of samples spread over the whole length, all of them there."""
        every = slice(None, None, max(1, self.u.size // LOOKED_AT))
        there = np.isfinite(self.y[every])
        return self.u[every][there], self.y[every][there]

    def neighbours(self) -> tuple[Array, Array]:
        """Input and output of samples that follow each other."""
        parts = [slice(None, LOOKED_AT), slice(max(LOOKED_AT, self.u.size - LOOKED_AT), None)]
        return np.concatenate([self.u[part] for part in parts]), np.concatenate([self.y[part] for part in parts])


def falls(recording: Recording, input_column: str, output_column: str) -> bool:
    """Whether the output falls where the input rises, slowly too; parameters as for `check_suitable`."""
    u, y = recording.channel(input_column), recording.channel(output_column)
    there = np.isfinite(y)
    if not there.any() or np.ptp(u) == 0.0 or np.ptp(y[there]) == 0.0:
        return False
    if np.corrcoef(u[there], y[there])[0, 1] >= OPPOSITE:
        return False
    slow = [_slow_part(np.where(there, one, np.nan), u) for one in (u, y)]  # beyond a resonance a reading is opposite
    return bool(np.corrcoef(slow[0], slow[1])[0, 1] < OPPOSITE)


def check_suitable(recording: Recording, input_column: str, output_column: str) -> list[str]:
    """Refuse a recording that cannot tell anything.

    Parameters
    ----------
    recording
        Such as `load_recordings` gives.
    input_column, output_column
        Its columns.

    Returns
    -------
    warnings
        One line for each thing that may be wrong, and may be not.

    Raises
    ------
    RecordingError
        What is wrong, where, the value, the limit, and what to record instead.
    """
    u, y = recording.channel(input_column), recording.channel(output_column)
    pair = _Pair(recording.source, input_column, output_column, recording.time_s, u, y)
    _refuse_empty(pair)
    _refuse_ramp(pair)
    judges = (_implausible, _rate, _copied, _loose, _wrong_way, _saturated)
    return [f"{pair.source}: {warning}" for judge in judges for warning in judge(pair)]


def _refuse_empty(pair: _Pair) -> None:
    """Too short, no number, no change, a hole in the input."""
    if pair.u.size < FEWEST_SAMPLES:
        raise pair.refused(f"has {pair.u.size} samples, needs at least {FEWEST_SAMPLES}; {ADVICE}")
    for name, values in ((pair.input, pair.u), (pair.output, pair.y)):
        low, high = _range(values)
        if np.isnan(low):
            raise pair.refused(f"{name} holds no number at all; {ADVICE}")
        if high - low <= 1e-9 * max(abs(low), abs(high)):
            raise pair.refused(f"{name} is constant at {low:.6g}; {ADVICE}")
    low, high = (float(each.reduce(pair.u, where=np.isfinite(pair.y), initial=np.nan)) for each in (np.fmin, np.fmax))
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        raise pair.refused(f"{pair.input} is constant at {low:.6g} wherever {pair.output} is there; {ADVICE}")
    absent = np.count_nonzero(~np.isfinite(pair.u))
    if absent:
        raise pair.refused(
            f"{pair.input} has {absent} missing samples: the memory cannot be followed across them; cut it there"
        )


def _refuse_ramp(pair: _Pair) -> None:
    """One ramp without a way back."""
    rise, fall = _travel(pair.u)
    turned, swing = min(rise, fall), float(np.ptp(pair.u))
    if turned < ONE_WAY * swing:
        raise pair.refused(
            f"{pair.input} only {'falls' if fall > rise else 'rises'}, turns back by {100 * turned / swing:.2g} % of "
            f"its swing, must by {100 * ONE_WAY:.0f} %: one ramp shows no loop; {ADVICE}"
        )


def _implausible(pair: _Pair) -> Iterator[str]:
    """Values a thousand times too large or too small for their unit."""
    for name, values, unit in ((pair.input, pair.u, "V"), (pair.output, pair.y, "N")):
        if unit_of(name) != unit:
            continue
        least, most, who = PLAUSIBLE[unit]
        largest = max(abs(value) for value in _range(values))
        if least <= largest <= most:
            continue
        perhaps = f"{'k' if largest < least else 'm'}{unit}"
        yield (
            f"{name} reaches {largest:.4g} {unit}, {who} {least:g} to {most:g} {unit}: is it {perhaps}? "
            f"Then name the column {name.removesuffix(unit)}{perhaps}"
        )


def _rate(pair: _Pair) -> Iterator[str]:
    """Time that is hardly in seconds."""
    rate_Hz = float((pair.time_s.size - 1) / (pair.time_s[-1] - pair.time_s[0]))
    low_Hz, high_Hz = RATES_HZ
    if not low_Hz <= rate_Hz <= high_Hz:
        yield f"time_s gives {rate_Hz:.4g} samples a second, plausible are {low_Hz:g} to {high_Hz:g}: is it in seconds?"


def _copied(pair: _Pair) -> Iterator[str]:
    """Two columns that are one."""
    u, y = pair.some()
    gain, offset = _line(u, y)
    if np.abs(y - offset - gain * u).max() > 1e-6 * np.ptp(y):
        return
    if abs(gain - 1.0) < 1e-6:
        raise pair.refused(f"{pair.output} is {pair.input} once more; record what the sensor measures")
    yield (
        f"{pair.output} is {pair.input} times {gain:.6g} {offset:+.6g}, without hysteresis or noise: is it a copy? "
        "Record what the sensor measures"
    )


def _loose(pair: _Pair) -> Iterator[str]:
    """An output that runs against its input, or is noise beside what the input does to it."""
    u, y = pair.some()
    together = float(np.corrcoef(u, y)[0, 1])
    if together < OPPOSITE:
        raise pair.refused(
            f"{pair.output} falls where {pair.input} rises (correlation {together:.2f}); check the sensor's sign"
        )
    near_u, near_y = pair.neighbours()
    if together >= LOOSE:
        gain, _ = _line(u, y)
        answer, noise = gain * float(np.ptp(u)), _noise(near_y - gain * near_u)
        if answer < QUIET * noise:
            yield (
                f"{pair.output} answers by {answer:.3g} over noise of {noise:.3g}, should by {QUIET:g} times that; "
                f"raise the peak of {pair.input}"
            )
        return
    for name, values, near in ((pair.input, u, near_u), (pair.output, y, near_y)):
        swing, noise = float(np.std(values)) * np.sqrt(12.0), _noise(near)  # of a triangle, which outliers do not tell
        if swing < QUIET * noise:
            yield (
                f"{name} swings by {swing:.3g} over noise of {noise:.3g}, should by {QUIET:g} times that, or moves too "
                f"fast for its samples; {ADVICE}"
            )
    yield (
        f"{pair.output} hardly follows {pair.input}, correlation {together:.2f}, should be above {LOOSE:g}; check that "
        "they were recorded together"
    )


def _wrong_way(pair: _Pair) -> Iterator[str]:
    """A loop of force or displacement over voltage that runs clockwise: the effect before its cause."""
    units = {unit_of(pair.input), unit_of(pair.output)}
    if "V" not in units or not units & ({"N"} | set(UNITS["displacement"])):
        return
    # beyond a resonance an output lags by more than half a turn; a cause leads however slowly it moves
    opening = _opening(*(_slow_part(one, pair.u) for one in (pair.u, pair.y)))
    if opening >= -LEADS:
        return
    line = (
        f"{pair.output} leads {pair.input}, their loop runs clockwise (mean opening {100 * opening:.1f} % of range, "
        f"must be above {-100 * LEADS:g} %)"
    )
    u, y = pair.neighbours()
    input_noise, output_noise = _noise(u) / float(np.std(u)), _noise(y) / float(np.nanstd(y))
    if output_noise <= max(CLEANER * input_noise, 1e-4):
        raise pair.refused(f"{line}: are the columns swapped? Name them the other way round")
    yield f"{line}: does the load cell's amplifier leak, or is {pair.input} recorded late?"


def _saturated(pair: _Pair) -> Iterator[str]:
    """An output that stays at its top while the input goes on."""
    u, y = pair.some()
    top = u[y > y.max() - 0.01 * np.ptp(y)]
    if np.ptp(top) > SATURATED * np.ptp(u):
        yield (
            f"{pair.output} stays within 1 % of its range below {y.max():.4g} from {pair.input} {top.min():.4g} to "
            f"{top.max():.4g}: saturated? Give the sensor a larger range, or lower the peak"
        )


def _range(values: Array) -> tuple[float, float]:
    """Smallest and largest number; nan where there is none."""
    return float(np.fmin.reduce(values)), float(np.fmax.reduce(values))


def _line(u: Array, y: Array) -> tuple[float, float]:
    """Gain and offset of the straight line through the samples."""
    gain = float(np.cov(u, y)[0, 1] / np.var(u, ddof=1))
    return gain, float(np.mean(y) - gain * np.mean(u))


def _noise(values: Array) -> float:
    """Standard deviation of white noise, from second differences: their median does not see corners and steps."""
    bends = np.abs(np.diff(values, 2))
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends)) / (0.6745 * np.sqrt(6.0)) if bends.size else 0.0


def _pieces(samples: int) -> Iterator[slice]:
    """Parts of a record that share their end and beginning."""
    for start in range(0, samples - 1, LOOKED_AT):
        yield slice(start, start + LOOKED_AT + 1)


def _travel(u: Array) -> tuple[float, float]:
    """How far the input goes up and down altogether, without its noise and its smallest reversals."""
    swing = float(np.ptp(u))
    width = min(0.005 * swing + 5.0 * _noise(u[:LOOKED_AT]), 0.04 * swing)
    packed = np.array([width, 0.0, float(u[0])])
    rise = fall = 0.0
    for part in _pieces(u.size):
        followed = np.empty((u[part].size, 1))
        play_states_run(packed, 0, 1, u[part], followed)
        steps = np.diff(followed[:, 0])
        rise += float(steps[steps > 0.0].sum())
        fall -= float(steps[steps < 0.0].sum())
    return rise, fall


def _slow_part(values: Array, drive: Array) -> Array:
    """The same without what is faster than the slowest `SLOW` of the drive's power, shape (N,)."""
    known = np.isfinite(values)
    spectrum = np.fft.rfft(np.where(known, values - values[known].mean(), 0.0))
    power = np.abs(np.fft.rfft(np.nan_to_num(drive - np.nanmean(drive)))) ** 2
    slowest = int(np.searchsorted(np.cumsum(power), SLOW * power.sum())) + 1
    spectrum[slowest + 1 :] = 0.0
    return np.fft.irfft(spectrum, values.size)


def _opening(u: Array, y: Array) -> float:
    """Mean opening of the loop over its length, as share of the output's range; above 0 where the output lags.

    From the first to the last sample at which the input rises through the middle of its range, so that the path is
    closed; of an input that does so only once, over all of it, if it ends where it began.
    """
    low, high = _range(y)
    above = u > 0.5 * (u.min() + u.max())
    rises = np.flatnonzero(above[1:] & ~above[:-1])
    if rises.size < 2 and abs(u[-1] - u[0]) > ONE_WAY * np.ptp(u):
        return 0.0
    part = slice(int(rises[0]), int(rises[-1]) + 2) if rises.size > 1 else slice(None)
    u, y = u[part], y[part]
    area = sum(float(np.nansum((y[k][1:] + y[k][:-1]) * np.diff(u[k]))) for k in _pieces(u.size)) / 2.0
    return -2.0 * area / (sum(_travel(u)) * (high - low))
