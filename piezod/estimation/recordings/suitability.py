"""Checks whether a recording can determine a model: one line for each refusal or warning, with a remedy."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.estimation.recordings.noise import white_noise
from piezod.operators.play import play_states_run
from piezod.recording import Recording
from piezod.recording.names import unit_of
from piezod.recording.quantities import UNITS

FEWEST_SAMPLES = 100
ADVICE = "record triangles from 0 over the whole range (piezod record --excitation varying-triangles)"

PLAUSIBLE = {"V": (5.0, 1500.0, "a piezo amplifier drives"), "N": (0.5, 50_000.0, "a piezo stack gives")}
"""Range of the largest value by unit, from the amplifiers and stacks on the market."""

RATES_HZ = (0.1, 1e6)
LOOSE, OPPOSITE = 0.3, -0.5  # correlations below which the output hardly follows the input, or runs against it
QUIET = 10.0  # smallest swing, in standard deviations of the noise
LEAST_RETURN = 0.1  # share of its swing by which the input must turn back
SLOW = (0.1, 0.5)
"""Shares of the drive's power in its slow part: the fundamental of triangles, the slowest tenth of a broadband drive.

Where the slowest tenth repeats no rise, as the trend of a decaying sine, the slower half is used."""

SLOW_CYCLES = 10
"""Cycles in the recording that the slow part holds at least: slower ones are a trend of a decaying or random drive."""

LEADS = 0.01  # mean opening of a clockwise loop, as share of the output's range, above which the output leads the input
CLEANER = 5.0  # ratio of output noise to input noise above which the input is a command, not a measured force
SCATTERED = 1.0 / 3.0
"""Share of the output's variance outside a loop, above which no columns are swapped: 409 of 410 recordings of emulated
benches, half of them swapped, leave less; the 18 pairs of a mirror that three stacks move (CubeSpec) leave 0.4 to 1."""

SATURATED = 0.25  # share of the input's swing over which the output may stay within 1 % of its range below the maximum
BLOCK = 2**20  # samples in a block; a statistic needs no more


@dataclass(frozen=True)
class _Pair:
    """Input u and output y of a recording, shape (N,), with file and columns for messages; a missing y is nan."""

    source: str
    input: str
    output: str
    time_s: Array
    u: Array
    y: Array

    def refused(self, why: str) -> RecordingError:
        """Error with the file and a reason."""
        return RecordingError(f"{self.source}: {why}")

    def thinned(self) -> tuple[Array, Array]:
        """Input and output of finite samples, evenly spread over the recording."""
        every = slice(None, None, max(1, self.u.size // BLOCK))
        finite = np.isfinite(self.y[every])
        return self.u[every][finite], self.y[every][finite]

    def first_and_last(self) -> tuple[Array, Array]:
        """Input and output of consecutive samples, the first and the last block."""
        parts = [slice(None, BLOCK), slice(max(BLOCK, self.u.size - BLOCK), None)]
        return np.concatenate([self.u[part] for part in parts]), np.concatenate([self.y[part] for part in parts])


def falls(recording: Recording, input_column: str, output_column: str) -> bool:
    """Whether the output falls where the input rises, also in its slow part."""
    u, y = recording.channel(input_column), recording.channel(output_column)
    finite = np.isfinite(y)
    if not finite.any() or np.ptp(u) == 0.0 or np.ptp(y[finite]) == 0.0:
        return False
    if np.corrcoef(u[finite], y[finite])[0, 1] >= OPPOSITE:
        return False
    # above a resonance a reading is opposite to the force
    slow = _slow_parts(*(np.where(finite, values, np.nan) for values in (u, y)))
    return bool(np.corrcoef(slow[0], slow[1])[0, 1] < OPPOSITE)


def check_suitable(recording: Recording, input_column: str, output_column: str) -> list[str]:
    """Refuse a recording that cannot determine a model.

    Returns
    -------
    warnings
        One line for each possible fault.

    Raises
    ------
    RecordingError
        The recording has a certain fault; the message names a suitable recording.
    """
    u, y = recording.channel(input_column), recording.channel(output_column)
    pair = _Pair(recording.source, input_column, output_column, recording.time_s, u, y)
    _refuse_empty(pair)
    _refuse_ramp(pair)
    checks = (_implausible, _rate, _copied, _loose, _wrong_way, _saturated)
    return [f"{pair.source}: {warning}" for check in checks for warning in check(pair)]


def _refuse_empty(pair: _Pair) -> None:
    """Refuse a recording that is too short, has no numbers, a constant column, or a hole in the input."""
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
    """Refuse a single ramp: the input must turn back."""
    rise, fall = _travel(pair.u)
    turned, swing = min(rise, fall), float(np.ptp(pair.u))
    if turned < LEAST_RETURN * swing:
        raise pair.refused(
            f"{pair.input} only {'falls' if fall > rise else 'rises'}, turns back by {100 * turned / swing:.2g} % of "
            f"its swing, must by {100 * LEAST_RETURN:.0f} %: one ramp shows no loop; {ADVICE}"
        )


def _implausible(pair: _Pair) -> Iterator[str]:
    """Values that are implausibly large or small for their unit."""
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
    """A sample rate that suggests another unit of time."""
    rate_Hz = float((pair.time_s.size - 1) / (pair.time_s[-1] - pair.time_s[0]))
    low_Hz, high_Hz = RATES_HZ
    if not low_Hz <= rate_Hz <= high_Hz:
        yield f"time_s gives {rate_Hz:.4g} samples a second, plausible are {low_Hz:g} to {high_Hz:g}: is it in seconds?"


def _copied(pair: _Pair) -> Iterator[str]:
    """An output that is a copy of the input."""
    u, y = pair.thinned()
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
    """An output that runs against the input, hardly follows it, or moves less than its noise."""
    u, y = pair.thinned()
    correlation = float(np.corrcoef(u, y)[0, 1])
    if correlation < OPPOSITE:
        raise pair.refused(
            f"{pair.output} falls where {pair.input} rises (correlation {correlation:.2f}); check the sensor's sign"
        )
    near_u, near_y = pair.first_and_last()
    if correlation >= LOOSE:
        gain, _ = _line(u, y)
        answer, noise = gain * float(np.ptp(u)), _noise(near_y - gain * near_u)
        if answer < QUIET * noise:
            yield (
                f"{pair.output} answers by {answer:.3g} over noise of {noise:.3g}, should by {QUIET:g} times that; "
                f"raise the peak of {pair.input}"
            )
        return
    for name, values, near in ((pair.input, u, near_u), (pair.output, y, near_y)):
        # swing of a triangle from its standard deviation, because outliers would spoil the range
        swing, noise = float(np.std(values)) * np.sqrt(12.0), _noise(near)
        if swing < QUIET * noise:
            yield (
                f"{name} swings by {swing:.3g} over noise of {noise:.3g}, should by {QUIET:g} times that, or moves too "
                f"fast for its samples; {ADVICE}"
            )
    yield (
        f"{pair.output} hardly follows {pair.input}, correlation {correlation:.2f}, should be above {LOOSE:g}; "
        "were they recorded together, or do modes, filters or delays lie between them?"
    )


def _wrong_way(pair: _Pair) -> Iterator[str]:
    """A clockwise loop of force or displacement over voltage, in which the output leads the input."""
    units = {unit_of(pair.input), unit_of(pair.output)}
    if "V" not in units or not units & ({"N"} | set(UNITS["displacement"])):
        return
    # only slow parts: above a resonance an output lags by more than half a cycle, and then seems to lead
    slow_u, slow_y = _slow_parts(pair.u, pair.y)
    opening = _opening(slow_u, slow_y)
    if opening >= -LEADS:
        return
    line = (
        f"{pair.output} leads {pair.input}, their loop runs clockwise (mean opening {100 * opening:.1f} % of range, "
        f"must be above {-100 * LEADS:g} %)"
    )
    u, y = pair.first_and_last()
    input_noise, output_noise = _noise(u) / float(np.std(u)), _noise(y) / float(np.nanstd(y))
    measured = output_noise > max(CLEANER * input_noise, 1e-4)
    if not measured and _outside_a_loop(slow_u, slow_y) <= SCATTERED:
        raise pair.refused(f"{line}: are the columns swapped? Name them the other way round")
    yield f"{line}: does the load cell's amplifier leak, or is {pair.input} recorded late?"


def _saturated(pair: _Pair) -> Iterator[str]:
    """An output that stays at its maximum while the input moves."""
    u, y = pair.thinned()
    top = u[y > y.max() - 0.01 * np.ptp(y)]
    if np.ptp(top) > SATURATED * np.ptp(u):
        yield (
            f"{pair.output} stays within 1 % of its range below {y.max():.4g} from {pair.input} {top.min():.4g} to "
            f"{top.max():.4g}: saturated? Give the sensor a larger range, or lower the peak"
        )


def _range(values: Array) -> tuple[float, float]:
    """Smallest and largest number; nan without one."""
    return float(np.fmin.reduce(values)), float(np.fmax.reduce(values))


def _line(u: Array, y: Array) -> tuple[float, float]:
    """Gain and offset of the straight line through the samples."""
    gain = float(np.cov(u, y)[0, 1] / np.var(u, ddof=1))
    return gain, float(np.mean(y) - gain * np.mean(u))


def _noise(values: Array) -> float:
    """Standard deviation of the white noise in consecutive samples."""
    return white_noise(np.abs(np.diff(values, 2)))


def _pieces(samples: int) -> Iterator[slice]:
    """Blocks of a record; the last sample of each block is the first of the next."""
    for start in range(0, samples - 1, BLOCK):
        yield slice(start, start + BLOCK + 1)


def _travel(u: Array) -> tuple[float, float]:
    """Total rise and total fall of the input; a play operator removes noise and the smallest reversals."""
    swing = float(np.ptp(u))
    width = min(0.005 * swing + 5.0 * _noise(u[:BLOCK]), 0.04 * swing)
    packed = np.array([width, 0.0, float(u[0])])
    rise = fall = 0.0
    for part in _pieces(u.size):
        followed = np.empty((u[part].size, 1))
        play_states_run(packed, 0, 1, u[part], followed)
        steps = np.diff(followed[:, 0])
        rise += float(steps[steps > 0.0].sum())
        fall -= float(steps[steps < 0.0].sum())
    return rise, fall


def _slow_parts(u: Array, y: Array) -> tuple[Array, Array]:
    """Low-pass filtered input and output, shape (N,): a share `SLOW` of the input's power, at least `SLOW_CYCLES`."""
    spectra = [np.fft.rfft(np.where(np.isfinite(v), v - v[np.isfinite(v)].mean(), 0.0)) for v in (u, y)]
    power = np.cumsum(np.abs(spectra[0]) ** 2)
    ends = [max(int(np.searchsorted(power, share * power[-1])) + 1, SLOW_CYCLES) for share in SLOW]
    parts = [[np.fft.irfft(spectrum[: end + 1], u.size) for spectrum in spectra] for end in ends]
    slow_u, slow_y = next((part for part in parts if _rises(part[0]).size > 1), parts[0])
    return slow_u, slow_y


def _rises(u: Array) -> NDArray[np.int64]:
    """Samples before the input rises through its mid-range."""
    above = u > 0.5 * (u.min() + u.max())
    return np.flatnonzero(above[1:] & ~above[:-1])


def _outside_a_loop(u: Array, y: Array) -> float:
    """Share of the output's variance that a curve over the input, with one branch a direction, leaves."""
    level = (u - u.mean()) / np.ptp(u)
    curve = np.stack([level**power for power in range(4)], axis=1)
    branches = np.concatenate([curve, curve * np.sign(np.gradient(u))[:, None]], axis=1)
    return float(np.var(y - branches @ np.linalg.lstsq(branches, y, rcond=None)[0]) / np.var(y))


def _opening(u: Array, y: Array) -> float:
    """Mean opening of the loop over its length, as share of the output's range; above 0: the output lags.

    To close the path, it runs from the first to the last rise of the input through its mid-range. With a single rise
    it runs over the full record, if this ends where it began.
    """
    low, high = _range(y)
    rises = _rises(u)
    if rises.size < 2 and abs(u[-1] - u[0]) > LEAST_RETURN * np.ptp(u):
        return 0.0
    part = slice(int(rises[0]), int(rises[-1]) + 2) if rises.size > 1 else slice(None)
    u, y = u[part], y[part]
    area = sum(float(np.nansum((y[k][1:] + y[k][:-1]) * np.diff(u[k]))) for k in _pieces(u.size)) / 2.0
    return -2.0 * area / (sum(_travel(u)) * (high - low))
