"""Figures of merit, each defined once: errors, fit and hysteresis."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piezod.operators.play import play_states_run

Array = NDArray[np.float64]

MOST_SAMPLES = 500_000  # of a loop; 100 cells need no more
SMALL_REVERSAL = 0.005  # of the drive's range, half of what it must turn back by to begin another branch


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

    The record is cut into branches where the drive turns back by more than a hundredth of its range. Branches between
    the same ends after the same turn are one, and are averaged over cells of the drive. Of a record with loops of
    several sizes `down` is the highest falling branch and `up` the lowest rising one at x; where the response leads (a
    clockwise loop) the other way round. On a steady cycle that is the opening of its one loop.

    Parameters
    ----------
    drive
        What drives the loop: the voltage, or the reference of a feedforward run; shape (N,), rising and falling.
    response
        What answers, shape (N,).
    cells
        Equal cells over the range of `drive`; cells that only one direction reaches do not count.

    Raises
    ------
    ValueError
        No cell is reached both rising and falling.
    """
    drive, response = _thinned(drive, response)
    edges = np.linspace(drive.min(), drive.max(), cells + 1)
    cell = np.clip(np.searchsorted(edges, drive, side="right") - 1, 0, cells - 1)
    means: dict[bool, list[Array]] = {True: [], False: []}
    for upwards, parts in _alike(drive, float(edges[1] - edges[0])).items():
        for alike in parts:
            chosen = np.concatenate(alike)
            means[upwards].append(_cell_means(cell[chosen], drive[chosen], response[chosen], edges))
    up, down = np.array(means[True]), np.array(means[False])
    reached = [np.isfinite(branches).any(axis=0) for branches in (up, down) if branches.size]
    if len(reached) < 2 or not (reached[0] & reached[1]).any():
        raise ValueError("no loop: the drive must rise and fall over the same range")
    up, down = up[:, reached[0] & reached[1]], down[:, reached[0] & reached[1]]
    lags = np.sum(np.nanmean(down, axis=0) - np.nanmean(up, axis=0)) >= 0.0
    higher, lower = (down, up) if lags else (up, down)
    opening = np.max(np.nanmax(higher, axis=0) - np.nanmin(lower, axis=0))
    return float(100.0 * opening / (response.max() - response.min()))


def _thinned(drive: Array, response: Array) -> tuple[Array, Array]:
    """Fewer samples of a long record whose drive hardly moves between them."""
    every = drive.size // MOST_SAMPLES
    if every < 2 or every * float(np.mean(np.abs(np.diff(drive[:MOST_SAMPLES])))) > SMALL_REVERSAL * np.ptp(drive):
        return drive, response
    return drive[::every], response[::every]


def _alike(drive: Array, width: float) -> dict[bool, list[list[NDArray[np.integer]]]]:
    """Indices of the branches, rising (True) and falling, those together that run between the same ends.

    Each also after the same one: the first rise of a record is not the second.
    """
    groups: dict[tuple[int | None, ...], list[NDArray[np.integer]]] = {}
    before = None
    for part, upwards in _branches(drive):
        ends = [round(float(drive[k]) / width) for k in (part.start, min(part.stop, drive.size) - 1)]
        groups.setdefault((upwards, *ends, before), []).append(np.arange(part.start, min(part.stop, drive.size)))
        before = ends[0]
    return {way: [parts for key, parts in groups.items() if key[0] == way] for way in (True, False)}


def _branches(drive: Array) -> Iterator[tuple[slice, bool]]:
    """Stretches in which the drive goes one way, and whether that is upwards; a play does not see small reversals."""
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
    """Mean response a cell, moved along the branch's own slope to the cell's centre of the drive; nan where none is."""
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
