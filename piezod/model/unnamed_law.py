"""The unnamed law: what a model with all effects found still leaves out, as a table without a name.

    y = y_model + sum over m of lag_m(table_m(d1, d2))                       added, or
    y = y_model + (y_model - start) * sum over m of lag_m(table_m(d1, d2))    as a gain of the reading's stroke

One or two drivers d1, d2 are computed from the command and from the reading that the model expects. Each memory m has a
table over their grid and is followed by a first-order lag; the first memory has none. A mode is a lag with a complex
pole s and complex tables, of which the real part is added; a mode alone is linear dynamics. The law bends with nothing
that lies ahead, so it can be simulated and stepped, and without modes compensated. The form is a bank of lags behind a
static map (parallel Hammerstein model: M. Schoukens, K. Tiels (2017), Identification of block-oriented nonlinear
systems starting from linear approximations: A survey, Automatica 85, arXiv:1607.01217).
"""

import cmath
import math
from typing import Annotated, Literal, Self, get_args

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from piezod.arrays import Array
from piezod.config.checked import Section

Driver = Literal["command", "rate", "direction", "way", "stroke", "reading", "reading_rate"]
NAME = "unnamed_law"  # how `compensation_without` names it
DRIVERS: tuple[Driver, ...] = get_args(Driver)
"""Command, its rate, direction, way since the last reversal, last stroke, expected reading, and its rate."""

COMMAND, RATE, DIRECTION, WAY, STROKE, READING, READING_RATE = range(len(DRIVERS))
STARTED, EXTREME, TURNED, ORIGIN = (len(DRIVERS) + k for k in range(4))
STATES = len(DRIVERS) + 4
"""Places in the state array, before the states of the lags. STARTED is 0 before the first sample, 1 until the lags have
begun, and 2 later. EXTREME is that of the command since the last reversal, TURNED the command at the reversal, ORIGIN
the first expected reading."""

FINE = 20.0
"""Rates are spaced by log(1 + 20 r) of the ratio r to the largest rate: slow drives differ in their slow rates."""


class Axis(Section):
    """A driver of an unnamed law: its range, from the first to the last node of the tables, and its number of nodes."""

    driver: Driver
    low: float
    high: float
    nodes: Annotated[int, Field(ge=2, le=64)]

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low is {self.low:g}, must be below high, {self.high:g}")
        return self


class Mode(Section):
    """Mode of an unnamed law: natural frequency and damping ratio, and its complex table as two rows at the nodes."""

    frequency_Hz: Annotated[float, Field(gt=0)]
    damping_ratio: Annotated[float, Field(gt=0, lt=1)]
    real: Annotated[tuple[float, ...], Field(strict=False)]
    imaginary: Annotated[tuple[float, ...], Field(strict=False)]

    @property
    def pole(self) -> complex:
        """Pole in the upper half plane [1/s]."""
        return 2.0 * math.pi * self.frequency_Hz * complex(-self.damping_ratio, math.sqrt(1.0 - self.damping_ratio**2))


class UnnamedLaw(Section):
    """Tables of an unnamed law, in the unit of the output.

    `memories_s` are the time constants of the lags [s]; 0 is no lag. `tables` has one row for each of them: the values
    at the nodes, those of the last driver next to each other. The reversals that direction, way and stroke refer to are
    larger than `dead_band`, in the unit of the input. The rates are smoothed by a lag of `smoothing_s` [s]. With `gain`
    the tables are [1], and multiply the expected reading less its first value. `since` is when the law appeared.
    """

    drivers: Annotated[tuple[Axis, ...], Field(strict=False, min_length=1, max_length=2)]
    dead_band: Annotated[float, Field(gt=0)]
    smoothing_s: Annotated[float, Field(gt=0)]
    memories_s: Annotated[tuple[float, ...], Field(strict=False, min_length=1, max_length=12)]
    tables: Annotated[tuple[Annotated[tuple[float, ...], Field(strict=False)], ...], Field(strict=False, min_length=1)]
    gain: bool = False
    since: Literal["identification", "later"] = "later"
    modes: Annotated[tuple[Mode, ...], Field(strict=False, max_length=12)] = ()

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        nodes = self.nodes
        if len(self.tables) != len(self.memories_s):
            raise ValueError(f"tables has {len(self.tables)} rows, must have one for each of {len(self.memories_s)}")
        rows = [*self.tables, *(row for mode in self.modes for row in (mode.real, mode.imaginary))]
        if wrong := next((len(row) for row in rows if len(row) != nodes), None):
            raise ValueError(f"tables has a row of {wrong} values, must have {nodes}")
        if min(self.memories_s) < 0.0:
            raise ValueError(f"memories_s has {min(self.memories_s):g}, must be at least 0")
        return self

    @property
    def linear(self) -> bool:
        """Whether it is linear dynamics of the command or of the expected reading."""
        (driver, *more) = (axis.driver for axis in self.drivers)
        return not self.gain and not more and driver in ("command", "reading") and self.nodes == 2

    @property
    def nodes(self) -> int:
        """Number of nodes of its grid."""
        return int(np.prod([axis.nodes for axis in self.drivers]))

    def response(self, frequencies_Hz: Array, dt_s: float) -> NDArray[np.complex128]:
        """Frequency response of linear dynamics that step once a sample, shape (F,) [output unit per input unit].

        Parameters
        ----------
        frequencies_Hz
            Shape (F,), 0 to half the sampling rate.
        """
        (axis,), before = self.drivers, np.exp(-2.0j * math.pi * frequencies_Hz * dt_s)
        total: NDArray[np.complex128] = np.zeros(frequencies_Hz.size, np.complex128)
        for memory_s, row in zip(self.memories_s, self.tables, strict=True):
            keep = math.exp(-dt_s / memory_s) if memory_s > 0.0 else 0.0
            total += complex(row[1] - row[0]) * (1.0 - keep) / (1.0 - keep * before)
        for mode in self.modes:
            gain = complex(mode.real[1] - mode.real[0], mode.imaginary[1] - mode.imaginary[0])
            kept = cmath.exp(mode.pole * dt_s)
            for one, own in ((gain, kept), (gain.conjugate(), kept.conjugate())):  # the real part of the state
                total += 0.5 * one * (1.0 - own) / (1.0 - own * before)
        response: NDArray[np.complex128] = total / (axis.high - axis.low)
        return response

    def decays(self, time_s: Array) -> Array:
        """Decays of an unknown past in the readings, one of each lag and two of each mode, shape (N, K) [1].

        Parameters
        ----------
        time_s
            Times since the start, shape (N,) [s].
        """
        columns = [np.exp(-time_s / memory_s) for memory_s in self.memories_s if memory_s > 0.0]
        for mode in self.modes:
            past = np.exp(mode.pole * time_s)
            columns += [past.real, past.imag]
        return np.array(columns).reshape(-1, time_s.size).T


@numba.njit(cache=True)
def advance_drivers(state: Array, settings: Array, command: float, reading: float) -> None:
    """Advance the drivers by one sample.

    Parameters
    ----------
    state
        Drivers in the order of `DRIVERS`, then the numbers named below; it changes.
    settings
        Result of `settings_of`.
    command, reading
        Command and expected reading at this sample.
    """
    dead_band, keep, dt_s = settings[0], settings[1], settings[2]
    if state[STARTED] == 0.0:
        state[:] = 0.0
        state[STARTED], state[COMMAND], state[READING] = 1.0, command, reading
        state[EXTREME], state[TURNED], state[ORIGIN] = command, command, reading
    state[RATE] = keep * state[RATE] + (1.0 - keep) * (command - state[COMMAND]) / dt_s
    state[READING_RATE] = keep * state[READING_RATE] + (1.0 - keep) * (reading - state[READING]) / dt_s
    state[COMMAND], state[READING] = command, reading
    direction = state[DIRECTION]
    if direction == 0.0:
        if abs(command - state[TURNED]) > dead_band:
            state[DIRECTION] = 1.0 if command > state[TURNED] else -1.0
            state[EXTREME] = command
    elif direction * (command - state[EXTREME]) > 0.0:
        state[EXTREME] = command
    elif direction * (state[EXTREME] - command) > dead_band:
        state[STROKE] = abs(state[EXTREME] - state[TURNED])
        state[TURNED], state[EXTREME], state[DIRECTION] = state[EXTREME], command, -direction
    state[WAY] = abs(command - state[TURNED])


@numba.njit(cache=True)
def position(driver: int, value: float, low: float, high: float) -> float:
    """Place of a driver's value between the first node (0) and the last (1), within them."""
    if driver in (RATE, READING_RATE):
        part = math.log1p(FINE * min(abs(value) / high, 1.0)) / math.log1p(FINE)
        return 0.5 + 0.5 * part if value > 0.0 else 0.5 - 0.5 * part
    if driver in (WAY, STROKE):
        return math.sqrt(min(max(value / high, 0.0), 1.0))
    return min(max((value - low) / (high - low), 0.0), 1.0)


@numba.njit(cache=True)
def _positions(driver: int, values: Array, low: float, high: float) -> Array:
    places = np.empty(values.size)
    for k in range(values.size):
        places[k] = position(driver, values[k], low, high)
    return places


@numba.njit(cache=True)
def behind_modes(signal: Array, keeps: NDArray[np.complex128]) -> Array:
    """Real and imaginary parts of a signal behind each mode, shape (N, 2 M); a mode begins at rest.

    Parameters
    ----------
    signal
        Shape (N,).
    keeps
        Kept part of each mode in a sample, exp(pole dt), shape (M,).
    """
    behind = np.empty((signal.size, 2 * keeps.size))
    for m in range(keeps.size):
        state = complex(signal[0])
        for k in range(signal.size):
            state = keeps[m] * state + (1.0 - keeps[m]) * signal[k]
            behind[k, 2 * m], behind[k, 2 * m + 1] = state.real, state.imag
    return behind


@numba.njit(cache=True)
def lagged(columns: Array, keep: float) -> Array:
    """Columns behind a lag that begins at rest.

    Parameters
    ----------
    columns
        Shape (N, K).
    """
    behind = columns.copy()
    for k in range(1, columns.shape[0]):
        behind[k] = keep * behind[k - 1] + (1.0 - keep) * columns[k]
    return behind


@numba.njit(cache=True)
def _between(row: Array, k: int, width: int, part: float, part2: float) -> float:
    """Value of a table between its nodes, `part` and `part2` behind node k."""
    here, there = row[k], row[k + width]
    if width > 1:
        here += part2 * (row[k + 1] - here)
        there += part2 * (row[k + width + 1] - there)
    value: float = here + part * (there - here)
    return value


@numba.njit(cache=True)
def advance_law(state: Array, settings: Array, axes: Array, keeps: Array, tables: Array) -> float:
    """Value of the law for drivers that were advanced, and advance its lags.

    Parameters
    ----------
    state
        `STATES` drivers, then real and imaginary part of the state of each lag; it changes.
    settings
        Result of `settings_of`.
    axes
        Driver, low, high and nodes of each axis, shape (1 or 2, 4).
    keeps
        Real and imaginary kept part of each lag in a sample; 0: no lag, shape (M, 2).
    tables
        Real and imaginary table of each lag, shape (2 M, nodes).
    """
    begins, state[STARTED] = state[STARTED] == 1.0, 2.0
    place = position(int(axes[0, 0]), state[int(axes[0, 0])], axes[0, 1], axes[0, 2]) * (axes[0, 3] - 1.0)
    first = min(int(place), int(axes[0, 3]) - 2)
    part = place - first
    width, second, part2 = 1, 0, 0.0
    if axes.shape[0] > 1:
        width = int(axes[1, 3])
        place = position(int(axes[1, 0]), state[int(axes[1, 0])], axes[1, 1], axes[1, 2]) * (axes[1, 3] - 1.0)
        second = min(int(place), width - 2)
        part2 = place - second
    total = 0.0
    for m in range(keeps.shape[0]):
        real = _between(tables[2 * m], first * width + second, width, part, part2)
        imaginary = 0.0
        if keeps[m, 1] != 0.0:
            imaginary = _between(tables[2 * m + 1], first * width + second, width, part, part2)
        at = STATES + 2 * m
        if not begins:  # state = keep state + (1 - keep) now, in complex numbers
            past, quadrature = state[at] - real, state[at + 1] - imaginary
            real += keeps[m, 0] * past - keeps[m, 1] * quadrature
            imaginary += keeps[m, 0] * quadrature + keeps[m, 1] * past
        state[at], state[at + 1] = real, imaginary
        total += real
    return total * (state[READING] - state[ORIGIN]) if settings[3] > 0.0 else total


@numba.njit(cache=True)
def _run(
    state: Array, settings: Array, axes: Array, keeps: Array, tables: Array, command: Array, reading: Array
) -> Array:
    added = np.empty(command.size)
    for k in range(command.size):
        advance_drivers(state, settings, command[k], reading[k])
        added[k] = advance_law(state, settings, axes, keeps, tables)
    return added


@numba.njit(cache=True)
def _track(state: Array, settings: Array, command: Array, reading: Array) -> Array:
    drivers = np.empty((command.size, len(DRIVERS)))
    for k in range(command.size):
        advance_drivers(state, settings, command[k], reading[k])
        drivers[k] = state[: len(DRIVERS)]
    return drivers


class LawStep:
    """An unnamed law that advances sample by sample and allocates nothing."""

    def __init__(self, law: UnnamedLaw, dt_s: float) -> None:
        self._axes = np.array([[DRIVERS.index(one.driver), one.low, one.high, one.nodes] for one in law.drivers])
        keeps = [complex(math.exp(-dt_s / one) if one > 0.0 else 0.0) for one in law.memories_s]
        keeps += [cmath.exp(mode.pole * dt_s) for mode in law.modes]
        rows = [(row, (0.0,) * len(row)) for row in law.tables] + [(mode.real, mode.imaginary) for mode in law.modes]
        self._keeps = np.array([(keep.real, keep.imag) for keep in keeps])
        self._tables = np.array([row for pair in rows for row in pair])
        self._settings = settings_of(law.dead_band, law.smoothing_s, dt_s, gain=law.gain)
        self._state = np.zeros(STATES + 2 * len(keeps))

    def reset(self) -> None:
        """Return to rest at the next sample."""
        self._state[:] = 0.0

    def step(self, command: float, reading: float) -> float:
        """What the law adds to a reading, after one more sample.

        Parameters
        ----------
        command
            Command [input unit].
        reading
            Reading that the model expects without the law [output unit].
        """
        advance_drivers(self._state, self._settings, command, reading)
        return advance_law(self._state, self._settings, self._axes, self._keeps, self._tables)

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """State, settings, axes, kept parts and tables, for compiled steps."""
        return self._state, self._settings, self._axes, self._keeps, self._tables

    def steepest(self, span: float = 1.0) -> tuple[float, float]:
        """Largest change of the law within a sample, over a change of the command and of the expected reading [1].

        Parameters
        ----------
        span
            Range of the expected reading [output unit], which a gain multiplies.
        """
        slopes = {COMMAND: 0.0, READING: 0.0}
        shape = self._axes[:, 3].astype(int)
        for place, (driver, low, high, nodes) in enumerate(self._axes):
            kind = int(driver)
            if kind in (DIRECTION, STROKE):
                continue
            axis = Axis(driver=DRIVERS[kind], low=low, high=high, nodes=int(nodes))
            spacing = np.diff(node_values(axis)).reshape([-1 if one == place else 1 for one in range(shape.size)])
            total = 0.0
            for keep, table in zip(self._keeps @ (1.0, 1.0j), self._complex_tables(), strict=True):
                change = np.diff(table.reshape(shape), axis=place) / spacing
                total += abs(1.0 - keep) * float(np.abs(change).max())
            if kind in (RATE, READING_RATE):
                total *= (1.0 - self._settings[1]) / self._settings[2]
            slopes[READING if kind in (READING, READING_RATE) else COMMAND] += total
        if self._settings[3] > 0.0:
            slopes = {kind: span * slope for kind, slope in slopes.items()}
            slopes[READING] += float(np.abs(self._complex_tables()).max(axis=1).sum())
        return slopes[COMMAND], slopes[READING]

    def _complex_tables(self) -> NDArray[np.complex128]:
        tables: NDArray[np.complex128] = self._tables[::2] + 1j * self._tables[1::2]
        return tables

    def run(self, command: Array, reading: Array) -> Array:
        """The same for many samples, shape (N,)."""
        return _run(self._state, self._settings, self._axes, self._keeps, self._tables, command, reading)


def settings_of(dead_band: float, smoothing_s: float, dt_s: float, *, gain: bool = False) -> Array:
    """Settings of a step: dead band, kept part of the smoothed rates, sample period, and 1 for a gain."""
    return np.array([dead_band, np.exp(-dt_s / smoothing_s), dt_s, float(gain)])


def driver_tracks(command: Array, reading: Array, dead_band: float, smoothing_s: float, dt_s: float) -> Array:
    """All drivers over a recording, shape (N, 7), in the order of `DRIVERS`.

    Parameters
    ----------
    command, reading
        Command and expected reading, shape (N,).
    dead_band
        Largest reversal that counts as none [input unit].
    smoothing_s
        Time constant of the lag that smooths the rates [s].
    """
    return _track(np.zeros(STATES), settings_of(dead_band, smoothing_s, dt_s), command, reading)


def node_values(axis: Axis) -> Array:
    """Values of a driver at the nodes, shape (nodes,): the inverse of `positions`."""
    place, driver = np.linspace(0.0, 1.0, axis.nodes), DRIVERS.index(axis.driver)
    if driver in (RATE, READING_RATE):
        part = 2.0 * place - 1.0
        return axis.high * np.sign(part) * np.expm1(np.abs(part) * math.log1p(FINE)) / FINE
    if driver in (WAY, STROKE):
        return axis.high * place**2
    return axis.low + (axis.high - axis.low) * place


def positions(axis: Axis, values: Array) -> Array:
    """Places of a driver's values between the first node (0) and the last (1), shape (N,).

    Parameters
    ----------
    values
        Shape (N,).
    """
    placed: Array = _positions(DRIVERS.index(axis.driver), values, axis.low, axis.high)
    return placed
