"""Columns of the flexible model: smooth functions of drive, memory and time, without physics.

- Hat functions of voltage, modelled force, rate, and distance from the last reversal, each also times the direction.
- First-order low-passes of voltage, force, speed and heating at log-spaced times.
- Play operators on voltage and force, the force at neighbouring samples, and its extremes so far.
- Gain of the model over time, and time itself.

The columns are built block by block and kept only as Gram matrices.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np

from piezod.arrays import Array, Mask
from piezod.diagnose.localisation import coordinates
from piezod.estimation.recordings.series import Series
from piezod.operators.play import play_states_run

FORCE_KNOTS, RATE_KNOTS, WAY_KNOTS = 10, 7, 7
LOW_PASSES, HEAT_LOW_PASSES, DIRECTION_LOW_PASSES = 12, 6, 5
VOLTAGE_PLAYS, FORCE_PLAYS, CROSSED_PLAYS, CROSSED_KNOTS = 14, 12, 6, 4
EARLIER = (1, 2, 4, 8, 16)  # lags of the force [samples]
HIGH_FORCES = (0.5, 0.75, 0.9)  # quantiles of the force; the excess over them is summed over time
REST_RATE = 1e-6  # rate over the rms rate below which the command rests
GAIN_KNOTS, TIME_KNOTS, MOST_TIME_KNOTS = 10, 16, 64


@dataclass(frozen=True)
class Event:
    """Tone or jump in a residual, which gets a column.

    Parameters
    ----------
    kind
        "tone", "beat" (a tone at a frequency of the drive), "gain" (a tone in the gain of the model) or "jump".
    at
        Frequency [Hz], or time of the jump since the first sample [s].
    """

    kind: Literal["tone", "beat", "gain", "jump"]
    series: int
    at: float

    @property
    def width(self) -> int:
        """Number of its columns."""
        return 1 if self.kind == "jump" else 2


class Columns:
    """Columns of all recordings, with common knots, thresholds and times.

    Parameters
    ----------
    series, modelled
        Recordings and their simulated readings, shape (N,) each [N].
    """

    def __init__(self, series: Sequence[Series], modelled: Sequence[Array], events: Sequence[Event] = ()) -> None:
        self.series, self.modelled, self.events = list(series), list(modelled), list(events)
        u, force = np.concatenate([s.command_V for s in series]), np.concatenate(list(modelled))
        speed = np.concatenate([np.abs(coordinates.rate(s.command_V, s.dt_s)) for s in series])
        way = np.concatenate([coordinates.reversals(s.command_V)[1] for s in series])
        self.low_V, self.low_N = float(u.min()), float(force.min())
        self.middle_V, self.swing_V = float(u.mean()), max(float(np.ptp(u)), 1e-12)
        self.middle_N, self.swing_N = float(force.mean()), max(float(np.ptp(force)), 1e-12)
        self.speed_V_per_s = max(float(np.sqrt(np.mean(speed**2))), 1e-12)
        self.speed_knots = _knots(speed, RATE_KNOTS)
        self.way_knots = _knots(way / self.swing_V, WAY_KNOTS)
        self.high_forces = np.quantile((force - self.middle_N) / self.swing_N, HIGH_FORCES)
        dt_s, duration_s = min(s.dt_s for s in series), max(s.duration_s for s in series)
        self.times_s = coordinates.times(dt_s, duration_s, LOW_PASSES)
        self.time_knots = int(np.clip(MOST_TIME_KNOTS // len(series), 4, TIME_KNOTS))
        drive = _DriveColumns(self, 0).columns(slice(0, 2)).shape[1]
        per_recording = 1 + GAIN_KNOTS + self.time_knots
        self.count = drive + len(series) * per_recording + sum(event.width for event in self.events)

    @property
    def levels(self) -> Mask:
        """Mask of the columns that are the levels of the recordings, shape (count,)."""
        result: Mask = np.arange(self.count) < len(self.series)
        return result

    def stretches(self, number: int, edges: Sequence[int]) -> Iterator[tuple[slice, Array]]:
        """Stretches of one recording from its first sample on, with their columns, shape (n, count) each."""
        drive = _DriveColumns(self, number)
        for first, end in itertools.pairwise(edges):
            stretch = slice(first, end)
            yield stretch, self._columns(number, drive.columns(stretch), stretch)

    def _columns(self, number: int, drive: Array, stretch: slice) -> Array:
        series, recordings = self.series[number], len(self.series)
        out = np.zeros((stretch.stop - stretch.start, self.count))
        out[:, number] = 1.0
        at = recordings + drive.shape[1]
        out[:, recordings:at] = drive
        part = series.time_s[stretch] / series.duration_s
        gain = (self.modelled[number][stretch] - self.middle_N) / self.swing_N
        slow = _hats(part, np.linspace(0.0, 1.0, GAIN_KNOTS))
        out[:, at + GAIN_KNOTS * number : at + GAIN_KNOTS * (number + 1)] = slow * gain[:, None]
        at += GAIN_KNOTS * recordings
        out[:, at + self.time_knots * number : at + self.time_knots * (number + 1)] = _hats(
            part, np.linspace(0.0, 1.0, self.time_knots)
        )
        at += self.time_knots * recordings
        for event in self.events:
            if event.series == number:
                out[:, at : at + event.width] = _event_columns(event, series.time_s[stretch], gain)
            at += event.width
        return out


def _event_columns(event: Event, time_s: Array, gain: Array) -> Array:
    if event.kind == "jump":
        return (time_s >= event.at).astype(np.float64)[:, None]
    turn = 2.0 * np.pi * event.at * time_s
    both = np.stack((np.sin(turn), np.cos(turn)), axis=1)
    return both * gain[:, None] if event.kind == "gain" else both


class _DriveColumns:
    """Columns of one recording's drive, computed in successive stretches; the states are kept between them."""

    def __init__(self, shared: Columns, number: int) -> None:
        series = shared.series[number]
        self.shared = shared
        self.u = (series.command_V - shared.middle_V) / shared.swing_V
        self.force = (shared.modelled[number] - shared.middle_N) / shared.swing_N
        self.least_u = (shared.low_V - shared.middle_V) / shared.swing_V
        self.least_force = (shared.low_N - shared.middle_N) / shared.swing_N
        self.rate = coordinates.rate(series.command_V, series.dt_s)
        self.acceleration = np.gradient(self.rate)
        self.acceleration /= max(float(self.acceleration.std()), 1e-12)
        self.direction, way_V = coordinates.reversals(series.command_V)
        self.way = way_V / shared.swing_V
        self.dt_s, self.duration_s = series.dt_s, max(series.duration_s, series.dt_s)
        self.decays = coordinates.decay_factors(series.dt_s, shared.times_s)
        self.low_u, self.low_force = np.full(LOW_PASSES, self.u[0]), np.full(LOW_PASSES, self.force[0])
        self.low_speed, self.low_heat = np.zeros(HEAT_LOW_PASSES), np.zeros(HEAT_LOW_PASSES)
        self.low_direction = np.full(DIRECTION_LOW_PASSES, self.direction[0])
        self.widths_u, self.widths_force = _widths(VOLTAGE_PLAYS), _widths(FORCE_PLAYS)
        self.plays_u = np.zeros(VOLTAGE_PLAYS) + (0.0 - shared.middle_V) / shared.swing_V
        path = (np.array(series.path_V) - shared.middle_V) / shared.swing_V
        _plays(np.append(path, self.u[0]), self.widths_u, self.plays_u)
        self.plays_force = np.full(FORCE_PLAYS, self.force[0])
        self.extremes = np.array([self.force[0], self.force[0]])
        self.excess = np.zeros(len(HIGH_FORCES))

    def columns(self, stretch: slice) -> Array:
        """Columns in the next stretch, shape (n, columns)."""
        return np.hstack((*self._instantaneous(stretch), *self._low_passed(stretch), *self._hysteretic(stretch)))

    def _instantaneous(self, stretch: slice) -> Iterator[Array]:
        u, force, direction = self.u[stretch], self.force[stretch], self.direction[stretch, None]
        speed = np.abs(self.rate[stretch])
        knots = np.linspace(0.0, 1.0, FORCE_KNOTS)
        for values in (u - self.least_u, force - self.least_force):
            hats = _hats(values, knots)
            yield hats
            yield hats * direction
        speeds, ways = _hats(speed, self.shared.speed_knots), _hats(self.way[stretch], self.shared.way_knots)
        yield speeds
        yield speeds * direction
        yield ways
        yield ways * direction
        for column in (0, RATE_KNOTS // 2, RATE_KNOTS - 1):
            yield ways * (direction * speeds[:, column, None])
        rate = self.rate[stretch, None] / self.shared.speed_V_per_s
        at_rest = direction * (np.abs(rate) < REST_RATE)
        yield np.hstack((rate, rate * np.abs(rate), at_rest, self.acceleration[stretch, None]))
        yield self._shifted(stretch)

    def _shifted(self, stretch: slice) -> Array:
        """Change of the force since some earlier samples and until the next one."""
        index = np.arange(stretch.start, stretch.stop)
        last = self.force.size - 1
        places = [np.clip(index - back, 0, last) for back in (*EARLIER, -1)]
        return np.stack([self.force[place] - self.force[index] for place in places], axis=1)

    def _low_passed(self, stretch: slice) -> Iterator[Array]:
        size = stretch.stop - stretch.start
        speed = np.abs(self.rate[stretch]) / self.shared.speed_V_per_s
        slow = self.decays[-HEAT_LOW_PASSES:]
        for values, decays, state in (
            (self.u[stretch], self.decays, self.low_u),
            (self.force[stretch], self.decays, self.low_force),
            (speed, slow, self.low_speed),
            (speed**2, slow, self.low_heat),
            (self.direction[stretch], self.decays[:DIRECTION_LOW_PASSES], self.low_direction),
        ):
            out = np.empty((size, decays.size))
            coordinates.low_pass(np.ascontiguousarray(values), decays, state, out)
            yield out

    def _hysteretic(self, stretch: slice) -> Iterator[Array]:
        u, force = self.u[stretch], self.force[stretch]
        plays = _plays(u, self.widths_u, self.plays_u)
        yield plays
        yield _plays(force, self.widths_force, self.plays_force)
        some = plays[:, np.linspace(1, VOLTAGE_PLAYS - 1, CROSSED_PLAYS).astype(int)]
        hats = _hats(u - self.least_u, np.linspace(0.0, 1.0, CROSSED_KNOTS))
        for j in range(CROSSED_KNOTS):
            yield some * hats[:, j, None]
        speeds = _hats(np.abs(self.rate[stretch]), self.shared.speed_knots[:: RATE_KNOTS // 2])
        for j in (0, 2):
            yield some * speeds[:, j, None]
        highest = np.maximum.accumulate(np.append(self.extremes[0], force))[1:]
        lowest = np.minimum.accumulate(np.append(self.extremes[1], force))[1:]
        self.extremes = np.array([highest[-1], lowest[-1]])
        beyond = np.maximum(force[:, None] - self.shared.high_forces, 0.0) * (self.dt_s / self.duration_s)
        excess = self.excess + np.cumsum(beyond, axis=0)
        self.excess = excess[-1]
        yield np.column_stack((highest, lowest, excess))


def _widths(count: int) -> Array:
    """Thresholds of plays relative to the range, denser near 0."""
    return 0.5 * (np.arange(1, count + 1) / (count + 0.5)) ** 1.7


def _knots(values: Array, count: int) -> Array:
    """Strictly rising knots at quantiles."""
    knots = np.quantile(values, np.linspace(0.0, 0.995, count))
    least = 1e-3 * max(float(knots[-1] - knots[0]), 1e-9)
    result: Array = knots + least * np.arange(count)
    return result


def _hats(values: Array, knots: Array) -> Array:
    """Hat functions on knots, constant outside them, shape (n, knots)."""
    out = np.zeros((values.size, knots.size))
    _fill_hats(np.ascontiguousarray(values), knots, out)
    return out


@numba.njit(cache=True)
def _fill_hats(values: Array, knots: Array, out: Array) -> None:
    last = knots.size - 1
    for k in range(values.size):
        x = min(max(values[k], knots[0]), knots[last])
        j = 0
        while j < last - 1 and x > knots[j + 1]:
            j += 1
        part = (x - knots[j]) / (knots[j + 1] - knots[j])
        out[k, j] = 1.0 - part
        out[k, j + 1] = part


def _plays(values: Array, widths: Array, state: Array) -> Array:
    """Play operators minus their input, shape (n, widths); `state` is updated."""
    out = np.empty((values.size, widths.size))
    packed = np.concatenate((widths, np.zeros(widths.size), state))
    play_states_run(packed, 0, widths.size, np.ascontiguousarray(values), out)
    state[:] = packed[-widths.size :]
    out -= values[:, None]
    return out
