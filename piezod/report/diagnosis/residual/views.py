"""Views of the residuals: means and deviations in cells of a driver, and correlation with the past of the command."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array, Mask
from piezod.diagnose.localisation import coordinates
from piezod.report.diagnosis.residual.residuals import Residuals

CELLS = 40  # of a view, at most
FEWEST = 8  # readings of a cell that is shown
EXCLUDED = 0.002  # share of the driver's values beyond the first and beyond the last cell
NARROWEST = 0.2  # width of a cell, relative to equal cells
TIME_CONSTANTS = 14  # of the low-passes whose differences are the bands
SHORTEST_SAMPLES, LONGEST_SHARE = 8.0, 0.3  # range of the time constants: samples; share of the longest recording


@dataclass(frozen=True)
class Driver:
    """A quantity that a residual may depend on.

    Parameters
    ----------
    name
        Name of its CSV file and column: `voltage_V` ...
    axis
        Axis of the places that belong to it; empty for none.
    label
        Label of the axis, with unit.
    values
        Computes the quantity at each sample of a recording, shape (N,).
    directions
        Whether rising and falling commands have curves of their own.
    logarithmic
        Whether the axis is logarithmic.
    """

    name: str
    axis: str
    label: str
    values: Callable[[Residuals], Array]
    directions: bool = True
    logarithmic: bool = False


def drivers(command: str, output: str) -> list[Driver]:
    """All drivers except time."""
    since = "since the last reversal"
    return [
        Driver("voltage_V", "voltage_V", f"command [{command}]", lambda recording: recording.series.command_V),
        Driver("rate_V_per_s", "rate_V_per_s", f"rate of the command [{command}/s]", _rate, directions=False),
        Driver("force_N", "force_N", f"output of the given model [{output}]", lambda recording: recording.given),
        Driver("since_reversal_s", "", f"time {since} [s]", _time_since_reversal, logarithmic=True),
        Driver("amplitude_V", "amplitude_V", f"change of the command {since} [{command}]", _change_since_reversal),
        Driver("previous_level_V", "", f"command at the last reversal [{command}]", _command_at_reversal),
        Driver("temperature_C", "temperature_C", "temperature [°C]", _temperature, directions=False),
    ]


def time_driver(name: str, label: str) -> Driver:
    """Time of a single recording as a driver.

    Parameters
    ----------
    name
        Name of the CSV file and column of the driver.
    label
        Label of the axis, with unit.
    """
    return Driver(name, "time_s", label, lambda recording: recording.time_s, directions=False)


def since_reversal(u: Array) -> tuple[NDArray[np.int64], Array]:
    """Number of samples since the last reversal, and the command at that reversal, each shape (N,).

    Parameters
    ----------
    u
        Command, shape (N,).
    """
    direction, _ = coordinates.reversals(u)
    reversal = np.zeros(u.size, np.int64)
    for first, end, sign in _moves(direction):
        start = reversal[first - 1] if first else 0
        extreme = u[start : first + 1].argmin() if sign > 0.0 else u[start : first + 1].argmax()
        reversal[first:end] = start + int(extreme)
    return np.arange(u.size) - reversal, u[reversal]


def _moves(direction: Array) -> Iterator[tuple[int, int, float]]:
    """First sample, end and direction of each move in one direction."""
    edges = np.concatenate(([0], np.flatnonzero(np.diff(direction)) + 1, [direction.size]))
    for first, end in itertools.pairwise(edges):
        yield int(first), int(end), float(direction[first])


def _rate(recording: Residuals) -> Array:
    return coordinates.rate(recording.series.command_V, recording.series.dt_s)


def _time_since_reversal(recording: Residuals) -> Array:
    return np.maximum(since_reversal(recording.series.command_V)[0], 1) * recording.series.dt_s


def _change_since_reversal(recording: Residuals) -> Array:
    return coordinates.reversals(recording.series.command_V)[1]


def _command_at_reversal(recording: Residuals) -> Array:
    return since_reversal(recording.series.command_V)[1]


def _temperature(recording: Residuals) -> Array:
    assert recording.series.temperature_C is not None
    return recording.series.temperature_C


@dataclass(frozen=True)
class BinnedResidual:
    """A residual in the C cells of a view, each shape (C,).

    Parameters
    ----------
    mean, standard_deviation
        Over all readings of a cell.
    rising, falling
        Mean over the readings with rising or falling command; nan where there are too few.
    """

    mean: Array
    standard_deviation: Array
    rising: Array
    falling: Array


@dataclass(frozen=True)
class View:
    """Residuals of both models over one driver.

    Parameters
    ----------
    x, count
        Mean of the driver, and number of readings, in each cell, shape (C,).
    before, after
        Residual of the given and of the extended model.
    only
        The recording that the view shows; None: all recordings.
    """

    driver: Driver
    x: Array
    count: Array
    before: BinnedResidual
    after: BinnedResidual
    only: Residuals | None = None


def views(
    recordings: Sequence[Residuals], numbered: Sequence[tuple[int, Residuals]], units: tuple[str, str]
) -> list[View]:
    """Residuals over every driver that varies.

    Parameters
    ----------
    recordings
        Diagnosed recordings; each view except time shows all of them together.
    numbered
        Recordings that have a view over time, with their numbers.
    units
        Units of command and output.
    """
    known = drivers(*units)
    if any(recording.series.temperature_C is None for recording in recordings):
        known = [driver for driver in known if driver.axis != "temperature_C"]
    shown_views = [_view(recordings, driver) for driver in known]
    for number, recording in numbered:
        single = len(recordings) == 1
        name = "time_s" if single else f"time_s_{number}"
        label = "time [s]" if single else f"time [s], {recording.series.name}"
        shown_views.append(replace(_view([recording], time_driver(name, label)), only=recording))
    return [view for view in shown_views if view.x.size > 1]


def _view(recordings: Sequence[Residuals], driver: Driver) -> View:
    x = np.concatenate([driver.values(recording)[recording.series.counts] for recording in recordings])
    direction = np.concatenate(
        [coordinates.reversals(recording.series.command_V)[0][recording.series.counts] for recording in recordings]
    )
    scaled = np.log(x) if driver.logarithmic else x
    edges = _edges(scaled)
    cell = coordinates.cell_of(scaled, edges)
    cells = max(edges.size - 1, 1)
    count = np.bincount(cell, minlength=cells).astype(np.float64)
    shown = count >= FEWEST
    before, after = (
        _binned(np.concatenate([residual[r.series.counts] for residual, r in pairs]), direction, cell, shown)
        for pairs in ([(r.before, r) for r in recordings], [(r.after, r) for r in recordings])
    )
    return View(driver, np.bincount(cell, x, cells)[shown] / count[shown], count[shown], before, after)


def _edges(values: Array) -> Array:
    """Edges of the cells, shape (C + 1,).

    They combine cells of equal width with cells of equal numbers of readings. Edges that are too close are dropped.
    """
    low, high = (float(end) for end in np.quantile(values, (EXCLUDED, 1.0 - EXCLUDED)))
    if not high > low:
        return np.array([low, low])
    half = CELLS // 2
    both = np.concatenate((np.linspace(low, high, half + 1), np.quantile(values, np.linspace(0.0, 1.0, half + 1))))
    narrowest = NARROWEST * (high - low) / CELLS
    edges: list[float] = []
    for edge in np.unique(np.clip(both, low, high)):
        if not edges or edge - edges[-1] > narrowest:
            edges.append(float(edge))
    return np.array(edges)


def _binned(residual: Array, direction: Array, cell: NDArray[np.int64], shown: Mask) -> BinnedResidual:
    def mean(selected: Mask | None, values: Array) -> Array:
        weights = np.ones(values.size) if selected is None else selected.astype(np.float64)
        n = np.bincount(cell, weights, shown.size)[shown]
        sums = np.bincount(cell, weights * values, shown.size)[shown]
        return np.where(n >= FEWEST, sums / np.maximum(n, 1.0), np.nan)

    middle = mean(None, residual)
    spread = np.sqrt(np.maximum(mean(None, residual**2) - middle**2, 0.0))
    return BinnedResidual(middle, spread, mean(direction > 0.0, residual), mean(direction < 0.0, residual))


@dataclass(frozen=True)
class Memory:
    """Correlation of the residuals with B bands of the command's past.

    Parameters
    ----------
    age_s
        Mean time constant of each band, shape (B,) [s].
    before, after
        Correlation for the given and the extended model, shape (B,) [1].
    """

    age_s: Array
    before: Array
    after: Array


def memory(recordings: Sequence[Residuals]) -> Memory:
    """Correlate residuals with the command's past, over all recordings together.

    Parameters
    ----------
    recordings
        Recordings with their residuals, at least one.
    """
    dt_s = min(recording.series.dt_s for recording in recordings)
    longest_s = max(recording.series.duration_s for recording in recordings)
    times_s = coordinates.times(dt_s, longest_s, TIME_CONSTANTS, SHORTEST_SAMPLES, LONGEST_SHARE)
    bands_count = TIME_CONSTANTS - 1
    products, powers, band_powers = np.zeros((2, bands_count)), np.zeros(2), np.zeros(bands_count)
    for recording in recordings:
        bands = _bands(recording, times_s)
        counts = recording.series.counts
        residuals = np.stack([_centred(recording.before, counts), _centred(recording.after, counts)])
        products += residuals @ bands
        band_powers += np.sum(bands**2, axis=0)
        powers += np.sum(residuals**2, axis=1)
    correlation = products / np.sqrt(np.maximum(np.outer(powers, band_powers), 1e-300))
    return Memory(np.sqrt(times_s[:-1] * times_s[1:]), correlation[0], correlation[1])


def _bands(recording: Residuals, times_s: Array) -> Array:
    """Differences of neighbouring low-passes of the command, without mean, 0 at rejected readings, shape (N, B)."""
    low_passes = coordinates.low_passed(recording.series.command_V, recording.series.dt_s, times_s)
    bands = low_passes[:, :-1] - low_passes[:, 1:]
    counts = recording.series.counts
    bands -= bands[counts].mean(axis=0)
    result: Array = np.where(counts[:, None], bands, 0.0)
    return result


def _centred(values: Array, counts: NDArray[np.bool_]) -> Array:
    result: Array = np.where(counts, values - values[counts].mean(), 0.0)
    return result
