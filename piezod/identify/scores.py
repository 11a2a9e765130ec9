"""Figures of merit: errors, fit and hysteresis."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.operators.play import play_states_run

MOST_SAMPLES = 500_000  # samples of a record above which it is thinned; 100 cells need no more
SMALL_REVERSAL = 0.005  # share of the drive's range; a reversal by twice this share begins a new branch


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
    """Widest opening of the loops response(drive) in percent of the response's range.

        100 max_x |down(x) - up(x)| / (max response - min response)

    Source: the thesis, chapter 6; piezod/operators/README.md, "Maximum hysteresis".

    The record is cut into branches where the drive turns back by more than 1 % of its range. Branches with equal ends
    and an equal preceding turn are averaged over cells of the drive. With loops of several sizes, `down` is the highest
    falling branch and `up` the lowest rising branch at x. If the response leads (a clockwise loop), they are swapped.

    Parameters
    ----------
    drive
        Voltage, or reference of a feedforward run, shape (N,); it must rise and fall.
    response
        Force or displacement, shape (N,).
    cells
        Number of equal cells over the range of `drive`; a cell counts if both directions reach it.

    Raises
    ------
    ValueError
        No cell is reached in both directions.
    """
    drive, response = _thinned(drive, response)
    edges = np.linspace(drive.min(), drive.max(), cells + 1)
    cell = np.clip(np.searchsorted(edges, drive, side="right") - 1, 0, cells - 1)
    means: dict[bool, list[Array]] = {True: [], False: []}
    for upwards, groups in _grouped_branches(drive, float(edges[1] - edges[0])).items():
        for branches in groups:
            chosen = np.concatenate(branches)
            means[upwards].append(_cell_means(cell[chosen], drive[chosen], response[chosen], edges))
    up, down = np.array(means[True]), np.array(means[False])
    reached = [np.isfinite(rows).any(axis=0) for rows in (up, down) if rows.size]
    if len(reached) < 2 or not (reached[0] & reached[1]).any():
        raise ValueError("no loop: the drive must rise and fall over the same range")
    up, down = up[:, reached[0] & reached[1]], down[:, reached[0] & reached[1]]
    lags = np.sum(np.nanmean(down, axis=0) - np.nanmean(up, axis=0)) >= 0.0
    higher, lower = (down, up) if lags else (up, down)
    opening = np.max(np.nanmax(higher, axis=0) - np.nanmin(lower, axis=0))
    return float(100.0 * opening / (response.max() - response.min()))


def _thinned(drive: Array, response: Array) -> tuple[Array, Array]:
    """Every k-th sample of a long record whose drive hardly moves over k samples."""
    every = drive.size // MOST_SAMPLES
    if every < 2 or every * float(np.mean(np.abs(np.diff(drive[:MOST_SAMPLES])))) > SMALL_REVERSAL * np.ptp(drive):
        return drive, response
    return drive[::every], response[::every]


def _grouped_branches(drive: Array, width: float) -> dict[bool, list[list[NDArray[np.integer]]]]:
    """Indices of the rising (True) and falling branches, grouped by their ends and by the start of the branch before.

    So the first rise of a record is separate from the second.
    """
    groups: dict[tuple[int | None, ...], list[NDArray[np.integer]]] = {}
    before = None
    for part, upwards in _branches(drive):
        ends = [round(float(drive[k]) / width) for k in (part.start, min(part.stop, drive.size) - 1)]
        groups.setdefault((upwards, *ends, before), []).append(np.arange(part.start, min(part.stop, drive.size)))
        before = ends[0]
    return {way: [parts for key, parts in groups.items() if key[0] == way] for way in (True, False)}


def _branches(drive: Array) -> Iterator[tuple[slice, bool]]:
    """Stretches of rising (True) or falling drive; a play operator removes small reversals."""
    followed = np.empty((drive.size, 1))
    play_states_run(np.array([SMALL_REVERSAL * float(np.ptp(drive)), 0.0, drive[0]]), 0, 1, drive, followed)
    direction = np.sign(np.diff(followed[:, 0]))
    moving = np.flatnonzero(direction)
    turns = moving[1:][direction[moving[1:]] != direction[moving[:-1]]]
    starts = [*moving[:1], *turns]
    for start, end in zip(starts, [*turns, drive.size - 1], strict=True):
        way = direction[start : end + 1]
        last = start + int(np.flatnonzero(way == direction[start])[-1])
        yield slice(start, last + 2), bool(direction[start] > 0)


def _cell_means(cell: NDArray[np.integer], drive: Array, response: Array, edges: Array) -> Array:
    """Mean response of each cell, moved along the branch's slope to the cell's centre; nan in an empty cell."""
    cells = edges.size - 1
    count = np.bincount(cell, minlength=cells).astype(float)
    count[count == 0] = np.nan
    mean_response = np.bincount(cell, response, cells) / count
    mean_drive = np.bincount(cell, drive, cells) / count
    centre = 0.5 * (edges[1:] + edges[:-1])
    known = ~np.isnan(mean_response)
    slope = np.zeros(cells)
    if known.sum() > 1:
        slope[known] = np.gradient(mean_response[known], mean_drive[known])
    at_centre: Array = mean_response + slope * (centre - mean_drive)
    return at_centre
