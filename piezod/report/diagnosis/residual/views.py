"""Views of the residuals: means and standard deviations in cells of a driver."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array, Mask
from piezod.diagnose.localisation import coordinates
from piezod.report.diagnosis.residual.drivers import Driver, drivers, time_driver
from piezod.report.diagnosis.residual.residuals import Residuals

CELLS = 40  # of a view, at most
FEWEST = 8  # readings of a cell that is shown
EXCLUDED = 0.002  # share of the driver's values beyond the first and beyond the last cell
NARROWEST = 0.2  # width of a cell, relative to equal cells


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
    name, axis, label, directions, logarithmic
        As in `Driver`.
    x, count
        Mean of the driver, and number of readings, in each cell, shape (C,).
    before, after
        Residual of the given and of the extended model.
    only
        The recording that the view shows; None: all recordings.
    """

    name: str
    axis: str
    label: str
    x: Array
    count: Array
    before: BinnedResidual
    after: BinnedResidual
    directions: bool = True
    logarithmic: bool = False
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
    return View(
        driver.name,
        driver.axis,
        driver.label,
        np.bincount(cell, x, cells)[shown] / count[shown],
        count[shown],
        before,
        after,
        directions=driver.directions,
        logarithmic=driver.logarithmic,
    )


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
