"""A flexible model of a residual, which knows no physics: whatever smooth functions of drive, memory and time explain.

Columns: splines of voltage, modelled force, rate and way since the last reversal, also against direction; what fades of
voltage, force, speed and heating at log-spaced times; plays on voltage and on force; force some samples ago; extremes
so far; the model's own gain over time; time itself. Built stretch by stretch, kept only as Gram matrices.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.localisation import coordinates

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FORCE_KNOTS, RATE_KNOTS, WAY_KNOTS = 10, 7, 7
FADING, FADING_HEAT, FADING_DIRECTION = 12, 6, 5
VOLTAGE_PLAYS, FORCE_PLAYS, CROSSED_PLAYS, CROSSED_KNOTS = 14, 12, 6, 4
EARLIER = (1, 2, 4, 8, 16)  # samples ago
ABOVE = (0.5, 0.75, 0.9)  # quantiles of the force, the time above which is added up
STILL = 1e-6  # of the usual rate
GAIN_KNOTS, TIME_KNOTS, MOST_TIME_KNOTS = 10, 16, 64


@dataclass(frozen=True)
class Event:
    """A column that a look at the leftovers suggests.

    Parameters
    ----------
    kind
        "tone", "beat" (a tone at a frequency that the drive has), "gain" (a tone in the model's gain) or "jump".
    series
        Number of the recording.
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
    """What all recordings' columns have in common: knots, thresholds, times.

    Parameters
    ----------
    series
        Recordings.
    modelled
        Simulated readings, each shape (N,) [N].
    events
        Suggested columns.

    Attributes
    ----------
    count
        Number of columns.
    """

    def __init__(self, series: Sequence[Series], modelled: Sequence[Array], events: Sequence[Event] = ()) -> None:
        self.series, self.modelled, self.events = list(series), list(modelled), list(events)
        u, force = np.concatenate([one.command_V for one in series]), np.concatenate(list(modelled))
        speed = np.concatenate([np.abs(coordinates.rate(one.command_V, one.dt_s)) for one in series])
        way = np.concatenate([coordinates.reversals(one.command_V)[1] for one in series])
        self.low_V, self.low_N = float(u.min()), float(force.min())
        self.middle_V, self.swing_V = float(u.mean()), max(float(np.ptp(u)), 1e-12)
        self.middle_N, self.swing_N = float(force.mean()), max(float(np.ptp(force)), 1e-12)
        self.speed_V_per_s = max(float(np.sqrt(np.mean(speed**2))), 1e-12)
        self.speed_knots = _knots(speed, RATE_KNOTS)
        self.way_knots = _knots(way / self.swing_V, WAY_KNOTS)
        self.above = np.quantile((force - self.middle_N) / self.swing_N, ABOVE)
        dt_s, duration_s = min(one.dt_s for one in series), max(one.duration_s for one in series)
        self.times_s = coordinates.times(dt_s, duration_s, FADING)
        self.time_knots = int(np.clip(MOST_TIME_KNOTS // len(series), 4, TIME_KNOTS))
        drive = _Stretches(self, 0).drive(slice(0, 2)).shape[1]
        of_a_recording = 1 + GAIN_KNOTS + self.time_knots
        self.count = drive + len(series) * of_a_recording + sum(one.width for one in self.events)

    @property
    def levels(self) -> Mask:
        """Which columns are the recordings' levels."""
        result: Mask = np.arange(self.count) < len(self.series)
        return result

    def stretches(self, number: int, edges: Sequence[int]) -> Iterator[tuple[slice, Array]]:
        """Columns of one recording, stretch by stretch from its first sample on, each shape (n, count)."""
        states = _Stretches(self, number)
        for first, end in itertools.pairwise(edges):
            stretch = slice(first, end)
            yield stretch, self._columns(number, states, stretch)

    def _columns(self, number: int, states: "_Stretches", stretch: slice) -> Array:
        one, recordings = self.series[number], len(self.series)
        out = np.zeros((stretch.stop - stretch.start, self.count))
        out[:, number] = 1.0
        drive = states.drive(stretch)
        at = recordings + drive.shape[1]
        out[:, recordings:at] = drive
        part = one.time_s[stretch] / one.duration_s
        gain = (self.modelled[number][stretch] - self.middle_N) / self.swing_N
        slow = _hats(part, np.linspace(0.0, 1.0, GAIN_KNOTS))
        out[:, at + GAIN_KNOTS * number : at + GAIN_KNOTS * (number + 1)] = slow * gain[:, None]
        at += GAIN_KNOTS * recordings
        here = slice(at + self.time_knots * number, at + self.time_knots * (number + 1))
        out[:, here] = _hats(part, np.linspace(0.0, 1.0, self.time_knots))
        at += self.time_knots * recordings
        for event in self.events:
            if event.series == number:
                out[:, at : at + event.width] = _event_columns(event, one.time_s[stretch], gain)
            at += event.width
        return out


def _event_columns(event: Event, time_s: Array, gain: Array) -> Array:
    if event.kind == "jump":
        return (time_s >= event.at).astype(np.float64)[:, None]
    turn = 2.0 * np.pi * event.at * time_s
    both = np.stack((np.sin(turn), np.cos(turn)), axis=1)
    return both * gain[:, None] if event.kind == "gain" else both


class _Stretches:
    """The columns of one recording's drive, with what they remember from stretch to stretch."""

    def __init__(self, shared: Columns, number: int) -> None:
        one = shared.series[number]
        self.shared = shared
        self.u = (one.command_V - shared.middle_V) / shared.swing_V
        self.force = (shared.modelled[number] - shared.middle_N) / shared.swing_N
        self.low_u = (shared.low_V - shared.middle_V) / shared.swing_V
        self.low_force = (shared.low_N - shared.middle_N) / shared.swing_N
        self.rate = coordinates.rate(one.command_V, one.dt_s)
        self.bend = np.gradient(self.rate)
        self.bend /= max(float(self.bend.std()), 1e-12)
        self.direction, way_V = coordinates.reversals(one.command_V)
        self.way = way_V / shared.swing_V
        self.dt_s, self.duration_s = one.dt_s, max(one.duration_s, one.dt_s)
        times_s = shared.times_s
        self.keep = coordinates.fading(one.dt_s, times_s)
        self.fading_u, self.fading_force = np.full(FADING, self.u[0]), np.full(FADING, self.force[0])
        self.fading_speed, self.fading_heat = np.zeros(FADING_HEAT), np.zeros(FADING_HEAT)
        self.fading_direction = np.full(FADING_DIRECTION, self.direction[0])
        self.widths_u, self.widths_force = _widths(VOLTAGE_PLAYS), _widths(FORCE_PLAYS)
        self.plays_u = np.zeros(VOLTAGE_PLAYS) + (0.0 - shared.middle_V) / shared.swing_V
        path = (np.array(one.path_V) - shared.middle_V) / shared.swing_V
        _plays(np.append(path, self.u[0]), self.widths_u, self.plays_u)
        self.plays_force = np.full(FORCE_PLAYS, self.force[0])
        self.extremes = np.array([self.force[0], self.force[0]])
        self.above = np.zeros(len(ABOVE))

    def drive(self, stretch: slice) -> Array:
        """Columns of the drive, shape (n, columns)."""
        return np.hstack((*self._instantaneous(stretch), *self._fading(stretch), *self._hysteretic(stretch)))

    def _instantaneous(self, stretch: slice) -> Iterator[Array]:
        u, force, direction = self.u[stretch], self.force[stretch], self.direction[stretch, None]
        speed = np.abs(self.rate[stretch])
        knots = np.linspace(0.0, 1.0, FORCE_KNOTS)
        for values in (u - self.low_u, force - self.low_force):
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
        still = direction * (np.abs(rate) < STILL)
        yield np.hstack((rate, rate * np.abs(rate), still, self.bend[stretch, None]))
        yield self._shifted(stretch)

    def _shifted(self, stretch: slice) -> Array:
        """Force some samples ago, and at the next sample, less the force now."""
        index = np.arange(stretch.start, stretch.stop)
        last = self.force.size - 1
        places = [np.clip(index - back, 0, last) for back in (*EARLIER, -1)]
        return np.stack([self.force[place] - self.force[index] for place in places], axis=1)

    def _fading(self, stretch: slice) -> Iterator[Array]:
        size = stretch.stop - stretch.start
        speed = np.abs(self.rate[stretch]) / self.shared.speed_V_per_s
        slow = self.keep[-FADING_HEAT:]
        for values, keep, state in (
            (self.u[stretch], self.keep, self.fading_u),
            (self.force[stretch], self.keep, self.fading_force),
            (speed, slow, self.fading_speed),
            (speed**2, slow, self.fading_heat),
            (self.direction[stretch], self.keep[:FADING_DIRECTION], self.fading_direction),
        ):
            out = np.empty((size, keep.size))
            coordinates.faded(np.ascontiguousarray(values), keep, state, out)
            yield out

    def _hysteretic(self, stretch: slice) -> Iterator[Array]:
        u, force = self.u[stretch], self.force[stretch]
        plays = _plays(u, self.widths_u, self.plays_u)
        yield plays
        yield _plays(force, self.widths_force, self.plays_force)
        some = plays[:, np.linspace(1, VOLTAGE_PLAYS - 1, CROSSED_PLAYS).astype(int)]
        hats = _hats(u - self.low_u, np.linspace(0.0, 1.0, CROSSED_KNOTS))
        for j in range(CROSSED_KNOTS):
            yield some * hats[:, j, None]
        speeds = _hats(np.abs(self.rate[stretch]), self.shared.speed_knots[:: RATE_KNOTS // 2])
        for j in (0, 2):
            yield some * speeds[:, j, None]
        highest = np.maximum.accumulate(np.append(self.extremes[0], force))[1:]
        lowest = np.minimum.accumulate(np.append(self.extremes[1], force))[1:]
        self.extremes = np.array([highest[-1], lowest[-1]])
        beyond = np.maximum(force[:, None] - self.shared.above, 0.0) * (self.dt_s / self.duration_s)
        added = self.above + np.cumsum(beyond, axis=0)
        self.above = added[-1]
        yield np.column_stack((highest, lowest, added))


def _widths(count: int) -> Array:
    """Half widths of plays in parts of the range, denser near 0."""
    return 0.5 * (np.arange(1, count + 1) / (count + 0.5)) ** 1.7


def _knots(values: Array, count: int) -> Array:
    """Rising knots at quantiles; where quantiles fall together, evenly between."""
    knots = np.quantile(values, np.linspace(0.0, 0.995, count))
    least = 1e-3 * max(float(knots[-1] - knots[0]), 1e-9)
    result: Array = knots + least * np.arange(count)
    return result


def _hats(values: Array, knots: Array) -> Array:
    """Hat functions on knots, constant outside, shape (n, knots)."""
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
    """Play operators less their input, from a state that is moved on, shape (n, widths)."""
    out = np.empty((values.size, widths.size))
    _fill_plays(np.ascontiguousarray(values), widths, state, out)
    return out


@numba.njit(cache=True)
def _fill_plays(values: Array, widths: Array, state: Array, out: Array) -> None:
    for k in range(values.size):
        for i in range(widths.size):
            state[i] = max(values[k] - widths[i], min(values[k] + widths[i], state[i]))
            out[k, i] = state[i] - values[k]
