"""Figures of merit, each defined once: errors, fit and hysteresis."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rms(values: Array) -> float:
    """Root of the mean square, in the values' unit."""
    return float(np.sqrt(np.mean(np.square(values))))


def largest(values: Array) -> float:
    """Largest magnitude, in the values' unit."""
    return float(np.max(np.abs(values)))


def nrmse_percent(measured: Array, modelled: Array) -> float:
    """Fit in percent as MATLAB's `compare` defines it: 100 (1 - |y - yhat| / |y - mean(y)|)."""
    residual = np.linalg.norm(measured - modelled)
    spread = np.linalg.norm(measured - np.mean(measured))
    return float(100.0 * (1.0 - residual / spread))


def max_hysteresis_percent(drive: Array, response: Array, cells: int = 100) -> float:
    """Largest opening of the loop response(drive) in percent of the response's range.

        100 max_x |down(x) - up(x)| / (max response - min response)          (THEORY 1.8)

    Up and down are the means over a cell of `drive` of all samples taken while it rises and while it falls, so that
    noise is averaged and every cycle counts.

    Parameters
    ----------
    drive
        What drives the loop: the voltage, or the reference of a feedforward run; shape (N,), rising and falling.
    response
        What answers, shape (N,).
    cells
        Equal cells over the range of `drive`; cells that only one branch reaches do not count.

    Raises
    ------
    ValueError
        No cell is reached both rising and falling.
    """
    direction = np.sign(np.gradient(drive))
    edges = np.linspace(drive.min(), drive.max(), cells + 1)
    cell = np.clip(np.searchsorted(edges, drive, side="right") - 1, 0, cells - 1)
    rising = _cell_means(cell, drive, response, direction > 0, cells)
    falling = _cell_means(cell, drive, response, direction < 0, cells)
    openings = np.abs(falling - rising)
    if np.isnan(openings).all():
        raise ValueError("no loop: the drive must rise and fall over the same range")
    return float(100.0 * np.nanmax(openings) / (response.max() - response.min()))


def _cell_means(
    cell: NDArray[np.integer], drive: Array, response: Array, chosen: NDArray[np.bool_], cells: int
) -> Array:
    """Mean response a cell, moved along the branch's own slope to the cell's centre of the drive."""
    count = np.bincount(cell[chosen], minlength=cells).astype(float)
    count[count == 0] = np.nan
    mean_response = np.bincount(cell[chosen], response[chosen], cells) / count
    mean_drive = np.bincount(cell[chosen], drive[chosen], cells) / count
    edges = np.linspace(drive.min(), drive.max(), cells + 1)
    centre = 0.5 * (edges[1:] + edges[:-1])
    known = ~np.isnan(mean_response)
    slope = np.full(cells, np.nan)
    if known.sum() > 1:
        slope[known] = np.gradient(mean_response[known], mean_drive[known])
    at_centre: Array = mean_response + slope * (centre - mean_drive)
    return at_centre
