"""The unnamed law: what a model with all effects found still leaves out, as a table without a name.

    y = y_model + sum over m of lag_m(table_m(d1, d2))                       added, or
    y = y_model + (y_model - start) * sum over m of lag_m(table_m(d1, d2))    as a gain of the reading's stroke

One or two drivers d1, d2 are computed from the command and from the reading that the model expects. Each memory m has a
table over their grid and is followed by a first-order lag; the first memory has none. The law bends with nothing that
lies ahead, so it can be simulated, stepped and compensated. The form is a bank of first-order lags behind a static map
(parallel Hammerstein model: M. Schoukens, K. Tiels (2017), Identification of block-oriented nonlinear systems starting
from linear approximations: A survey, Automatica 85, arXiv:1607.01217).
"""

import math
from typing import Annotated, Literal, Self, get_args

import numba
import numpy as np
from pydantic import Field, model_validator

from piezod.arrays import Array
from piezod.config import Section

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


class UnnamedLaw(Section):
    """Tables of an unnamed law, in the unit of the output.

    `memories_s` are the time constants of the lags [s]; 0 is no lag. `tables` has one row for each of them: the values
    at the nodes, those of the last driver next to each other. The reversals that direction, way and stroke refer to are
    larger than `dead_band`, in the unit of the input. The rates are smoothed by a lag of `smoothing_s` [s]. With `gain`
    the tables are [1], and multiply the expected reading less its first value.
    """

    drivers: Annotated[tuple[Axis, ...], Field(strict=False, min_length=1, max_length=2)]
    dead_band: Annotated[float, Field(gt=0)]
    smoothing_s: Annotated[float, Field(gt=0)]
    memories_s: Annotated[tuple[float, ...], Field(strict=False, min_length=1, max_length=12)]
    tables: Annotated[tuple[Annotated[tuple[float, ...], Field(strict=False)], ...], Field(strict=False, min_length=1)]
    gain: bool = False

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        nodes = int(np.prod([axis.nodes for axis in self.drivers]))
        if len(self.tables) != len(self.memories_s):
            raise ValueError(f"tables has {len(self.tables)} rows, must have one for each of {len(self.memories_s)}")
        if wrong := next((len(row) for row in self.tables if len(row) != nodes), None):
            raise ValueError(f"tables has a row of {wrong} values, must have {nodes}")
        if min(self.memories_s) < 0.0:
            raise ValueError(f"memories_s has {min(self.memories_s):g}, must be at least 0")
        return self


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
def advance_law(state: Array, settings: Array, axes: Array, keeps: Array, tables: Array) -> float:
    """Value of the law for drivers that were advanced, and advance its lags.

    Parameters
    ----------
    state
        `STATES` drivers, then the state of each lag; it changes.
    settings
        Result of `settings_of`.
    axes
        Driver, low, high and nodes of each axis, shape (1 or 2, 4).
    keeps
        Kept part of each lag in a sample; 0: no lag, shape (M,).
    tables
        Shape (M, nodes).
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
    for m in range(keeps.size):
        k = first * width + second
        here, there = tables[m, k], tables[m, k + width]
        if width > 1:
            here += part2 * (tables[m, k + 1] - here)
            there += part2 * (tables[m, k + width + 1] - there)
        now = here + part * (there - here)
        state[STATES + m] = now if begins else keeps[m] * state[STATES + m] + (1.0 - keeps[m]) * now
        total += state[STATES + m]
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
        memories = np.array(law.memories_s)
        self._keeps = np.where(memories > 0.0, np.exp(-dt_s / np.maximum(memories, 1e-300)), 0.0)
        self._tables = np.array(law.tables)
        self._settings = settings_of(law.dead_band, law.smoothing_s, dt_s, gain=law.gain)
        self._state = np.zeros(STATES + memories.size)

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
            for keep, table in zip(self._keeps, self._tables, strict=True):
                change = np.diff(table.reshape(shape), axis=place) / spacing
                total += (1.0 - keep) * float(np.abs(change).max())
            if kind in (RATE, READING_RATE):
                total *= (1.0 - self._settings[1]) / self._settings[2]
            slopes[READING if kind in (READING, READING_RATE) else COMMAND] += total
        if self._settings[3] > 0.0:
            slopes = {kind: span * slope for kind, slope in slopes.items()}
            slopes[READING] += float(np.abs(self._tables).max(axis=1).sum())
        return slopes[COMMAND], slopes[READING]

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
