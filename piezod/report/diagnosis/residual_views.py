"""A residual seen from its drivers: binned means over voltage, rate, force, time, reversals, past and temperature."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose import coordinates
from piezod.diagnose.findings import Place
from piezod.diagnose.series import Series

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELLS = 40
FEWEST = 8  # readings a cell must hold to be shown
TIMES = 14  # of the past
SHORTEST_S, LONGEST = 8.0, 0.3  # samples; part of a recording


@dataclass(frozen=True)
class Residuals:
    """A recording that is asked about, with what is left of it.

    Parameters
    ----------
    series
        The recording.
    given, extended
        What the given and the extended model expect, shape (N,).
    """

    series: Series
    given: Array
    extended: Array

    @property
    def time_s(self) -> Array:
        """In the recording's own time, shape (N,)."""
        return self.series.start_s + self.series.time_s

    @property
    def measured(self) -> Array:
        """Readings, those that are missing not a number, shape (N,)."""
        known = self.series.counts | (self.series.reading_N != 0.0)
        return np.where(known, self.series.reading_N, np.nan)

    @property
    def before(self) -> Array:
        """Reading less given model, 0 where a reading is not believed, shape (N,)."""
        return np.where(self.series.counts, self.series.reading_N - self.given, 0.0)

    @property
    def after(self) -> Array:
        """Reading less extended model, as above."""
        return np.where(self.series.counts, self.series.reading_N - self.extended, 0.0)


@dataclass(frozen=True)
class State:
    """A residual in the cells of a view, each shape (C,).

    Parameters
    ----------
    mean, spread
        Over all readings of a cell: mean and standard deviation.
    rising, falling
        Means while the command rises and falls; not a number where it does not.
    """

    mean: Array
    spread: Array
    rising: Array
    falling: Array


@dataclass(frozen=True)
class View:
    """A residual over one driver, before and after.

    Parameters
    ----------
    name
        Of its CSV file and its columns: `voltage_V` ...
    axis
        Of the places that belong to it; empty for none.
    label
        For people.
    at, count
        Mean of the driver and number of readings in every cell, shape (C,).
    before, after
        What is left.
    directions
        Whether rising and falling are shown apart.
    logarithmic
        Whether its axis is.
    only
        The recording that it shows; None: all.
    """

    name: str
    axis: str
    label: str
    at: Array
    count: Array
    before: State
    after: State
    directions: bool = True
    logarithmic: bool = False
    only: Residuals | None = None


@dataclass(frozen=True)
class Memory:
    """How much of a residual goes with what fades of the command's past.

    Parameters
    ----------
    at_s
        Fading time of every band, shape (B,).
    before, after
        Correlation with the command's past of that age, shape (B,) [1].
    """

    at_s: Array
    before: Array
    after: Array


def views(asked: Sequence[Residuals], shown: Sequence[tuple[int, Residuals]], units: tuple[str, str]) -> list[View]:
    """Residuals over every driver that varies.

    Parameters
    ----------
    asked
        Recordings that are asked about, taken together.
    shown
        Those with a view over time of their own, and their numbers.
    units
        Of command and output.
    """
    drivers = _drivers(*units)
    if any(one.series.temperature_C is None for one in asked):
        drivers = [driver for driver in drivers if driver.axis != "temperature_C"]
    found = [_view(asked, driver, [driver.of(one) for one in asked]) for driver in drivers]
    for number, one in shown:
        name, label = (
            ("time_s", "time [s]") if len(asked) == 1 else (f"time_s_{number}", f"time [s], {one.series.name}")
        )
        of_time = _Driver(name, "time_s", label, _time, directions=False)
        found.append(replace(_view([one], of_time, [one.time_s]), only=one))
    return [one for one in found if one.at.size > 1]


def owners(places: Sequence[Place], asked: Sequence[Residuals]) -> dict[Place, Residuals]:
    """The recording that each place in time belongs to: times are each one's own, so the one with most left there."""

    def left(one: Residuals, place: Place) -> float:
        inside = slice(*np.searchsorted(one.time_s, (place.low, place.high)))
        error = one.series.reading_N[inside] - one.given[inside]
        return float(error @ error) / one.series.noise_N**2

    def owner(place: Place) -> Residuals:
        return max(asked, key=lambda one: left(one, place))

    return {place: owner(place) for place in places if place.axis == "time_s"}


def memory(asked: Sequence[Residuals]) -> Memory:
    """Correlation of residuals with the command's past, by its age."""
    dt_s = min(one.series.dt_s for one in asked)
    longest_s = max(one.series.duration_s for one in asked)
    times_s = coordinates.times(dt_s, longest_s, TIMES, SHORTEST_S, LONGEST)
    products, before, after, lengths = np.zeros((2, TIMES - 1)), 0.0, 0.0, np.zeros(TIMES - 1)
    for one in asked:
        bands = _faded_bands(one, times_s)
        left = [_centred(values, one.series.counts) for values in (one.before, one.after)]
        products += np.stack([values @ bands for values in left])
        lengths += np.sum(bands**2, axis=0)
        before += float(left[0] @ left[0])
        after += float(left[1] @ left[1])
    scale = np.sqrt(np.maximum(np.outer((before, after), lengths), 1e-300))
    correlation = products / scale
    return Memory(np.sqrt(times_s[:-1] * times_s[1:]), correlation[0], correlation[1])


def since_reversal(u: Array) -> tuple[NDArray[np.int64], Array]:
    """Samples since the last reversal, and the command there, each shape (N,)."""
    direction, _ = coordinates.reversals(u)
    turned = np.zeros(u.size, np.int64)
    for first, last, way in _moves(direction):
        start = turned[first - 1] if first else 0
        extreme = u[start : first + 1].argmin() if way > 0.0 else u[start : first + 1].argmax()
        turned[first:last] = start + int(extreme)
    return np.arange(u.size) - turned, u[turned]


def _moves(direction: Array) -> Iterator[tuple[int, int, float]]:
    """First sample, end and direction of every stretch of one direction."""
    edges = np.concatenate(([0], np.flatnonzero(np.diff(direction)) + 1, [direction.size]))
    for first, last in itertools.pairwise(edges):
        yield int(first), int(last), float(direction[first])


@dataclass(frozen=True)
class _Driver:
    """What a residual may depend on."""

    name: str
    axis: str
    label: str
    of: Callable[[Residuals], Array]
    directions: bool = True
    logarithmic: bool = False


def _drivers(command: str, output: str) -> list[_Driver]:
    since = "since the last reversal"
    return [
        _Driver("voltage_V", "voltage_V", f"command [{command}]", lambda one: one.series.command_V),
        _Driver("rate_V_per_s", "rate_V_per_s", f"rate of the command [{command}/s]", _rate, directions=False),
        _Driver("force_N", "force_N", f"output of the given model [{output}]", lambda one: one.given),
        _Driver("since_reversal_s", "", f"time {since} [s]", _since, logarithmic=True),
        _Driver("amplitude_V", "amplitude_V", f"way {since} [{command}]", _way),
        _Driver("previous_level_V", "", f"command at the last reversal [{command}]", _level),
        _Driver("temperature_C", "temperature_C", "temperature [°C]", _temperature, directions=False),
    ]


def _time(one: Residuals) -> Array:
    return one.time_s


def _rate(one: Residuals) -> Array:
    return coordinates.rate(one.series.command_V, one.series.dt_s)


def _since(one: Residuals) -> Array:
    return np.maximum(since_reversal(one.series.command_V)[0], 1) * one.series.dt_s


def _way(one: Residuals) -> Array:
    return coordinates.reversals(one.series.command_V)[1]


def _level(one: Residuals) -> Array:
    return since_reversal(one.series.command_V)[1]


def _temperature(one: Residuals) -> Array:
    assert one.series.temperature_C is not None
    return one.series.temperature_C


def _view(asked: Sequence[Residuals], driver: _Driver, values: Sequence[Array]) -> View:
    x = np.concatenate([v[one.series.counts] for v, one in zip(values, asked, strict=True)])
    way = np.concatenate([coordinates.reversals(one.series.command_V)[0][one.series.counts] for one in asked])
    edges = _edges(np.log(x) if driver.logarithmic else x)
    index = coordinates.cell_of(np.log(x) if driver.logarithmic else x, edges)
    cells = max(edges.size - 1, 1)
    count = np.bincount(index, minlength=cells).astype(np.float64)
    shown = count >= FEWEST
    at = np.bincount(index, x, cells)[shown] / count[shown]
    before, after = (
        _state(np.concatenate([left[one.series.counts] for left, one in pairs]), way, index, shown)
        for pairs in ([(one.before, one) for one in asked], [(one.after, one) for one in asked])
    )
    return View(
        driver.name,
        driver.axis,
        driver.label,
        at,
        count[shown],
        before,
        after,
        directions=driver.directions,
        logarithmic=driver.logarithmic,
    )


def _edges(values: Array) -> Array:
    """Equal cells and cells of equal numbers together, none much narrower than the others, shape (C + 1,)."""
    low, high = (float(one) for one in np.quantile(values, (0.002, 0.998)))
    if not high > low:
        return np.array([low, low])
    half = CELLS // 2
    both = np.concatenate((np.linspace(low, high, half + 1), np.quantile(values, np.linspace(0.0, 1.0, half + 1))))
    least = 0.2 * (high - low) / CELLS
    kept: list[float] = []
    for edge in np.unique(np.clip(both, low, high)):
        if not kept or edge - kept[-1] > least:
            kept.append(float(edge))
    return np.array(kept)


def _state(left: Array, way: Array, index: NDArray[np.int64], shown: Mask) -> State:
    def mean(of: Mask | None, values: Array) -> Array:
        weights = np.ones(values.size) if of is None else of.astype(np.float64)
        n = np.bincount(index, weights, shown.size)[shown]
        sums = np.bincount(index, weights * values, shown.size)[shown]
        return np.where(n >= FEWEST, sums / np.maximum(n, 1.0), np.nan)

    middle = mean(None, left)
    spread = np.sqrt(np.maximum(mean(None, left**2) - middle**2, 0.0))
    return State(middle, spread, mean(way > 0.0, left), mean(way < 0.0, left))


def _faded_bands(one: Residuals, times_s: Array) -> Array:
    """What fades between two times of the command's past, shape (N, TIMES - 1), about its mean where readings count."""
    low = coordinates.faded_columns(one.series.command_V, one.series.dt_s, times_s)
    bands = low[:, :-1] - low[:, 1:]
    counts = one.series.counts
    bands -= bands[counts].mean(axis=0)
    result: Array = np.where(counts[:, None], bands, 0.0)
    return result


def _centred(values: Array, counts: Mask) -> Array:
    result: Array = np.where(counts, values - values[counts].mean(), 0.0)
    return result
