"""Where a residual is: at which voltages, rates, forces, times, frequencies and pasts it is more than its own noise.

Every axis is cut into cells, every cell has a score, and one max-T over all cells of all axes, stepped down (Westfall
and Young 1993), keeps the chance of one false place at 5 %. The scores are compared with what the same residual gives
where nothing can be there:

- cells of the drive, and coherence with the model: the residual shifted circularly by a random time within each
  recording (a slow part cannot then pass for a function of the voltage), and also shifted with the sign of each block
  drawn and its slow part taken away (the shift of a periodic residual over a periodic drive says nothing by itself);
- cells of time, and of temperature, whose spread no shift changes: independent cells as uneven as neighbours are;
- lines, whose power no shift changes either: Gaussian noise with the spectrum of the line's surroundings.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.direct import lines
from piezod.diagnose.findings import Place
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.localisation.cells import Cells, Told
from piezod.diagnose.localisation.drive_cells import cells_of_drive
from piezod.diagnose.localisation.time_cells import cells_of_lines, cells_of_time_and_temperature

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

LEVEL = 0.05
SAME_LINE_HZ = 0.1
LEAST_SHARE = 0.005  # of the unexplained energy, below which a place is not told
LEAST_EXCESS = 0.02  # of a residual's power, below which shares are not measured against less


def locate(
    series: Sequence[Series],
    residuals: Sequence[Array],
    modelled: Sequence[Array],
    *,
    shifts: int = 99,
    seed: int = 0,
) -> list[Place]:
    """Find where residuals are more than noise.

    Parameters
    ----------
    series
        Only those with the role "recording" are looked at; times are in each recording's own time.
    residuals
        Reading less simulation, each shape (N,) [N].
    modelled
        Simulation, each shape (N,) [N].
    shifts
        How many references; the smallest p is 1 / (1 + shifts).
    seed
        Of the references.

    Returns
    -------
    list of Place
        The largest share first; empty when nothing is there.
    """
    told = [
        Told.of(one, residual, model)
        for one, residual, model in zip(series, residuals, modelled, strict=True)
        if one.role == "recording" and one.counts.any()
    ]
    if not told or not any(one.residual.any() for one in told):
        return []
    rng = np.random.default_rng(seed)
    cells = [
        *cells_of_drive(told, shifts, rng),
        *cells_of_time_and_temperature(told, shifts, rng),
        *cells_of_lines(told, shifts, rng),
    ]
    total = sum(float(one.residual @ one.residual) for one in told)
    noise = sum(float(np.count_nonzero(one.series.counts)) for one in told)
    unexplained = max(total - noise, LEAST_EXCESS * total)
    places = _without_repeats([*_places(cells, unexplained), *_lines(told, unexplained)])
    return sorted(places, key=lambda place: -place.share)


def _lines(told: Sequence[Told], unexplained: float) -> list[Place]:
    """Lines that stand out so far that no reference is needed, one place each however many recordings have it."""
    found: dict[float, Place] = {}
    for one in told:
        for line in lines(one.series, one.residual):
            energy = 0.5 * line.amplitude_N**2 * float(np.count_nonzero(one.series.counts))
            share = float(np.clip(energy / unexplained, 0.0, 1.0))
            chance = min(1.0, 0.5 * one.residual.size * 0.5**line.over_median)  # of exponential noise in all bins
            near = next((f for f in found if abs(f - line.frequency_Hz) < SAME_LINE_HZ), None)
            if share >= LEAST_SHARE and chance <= LEVEL and near is None:
                found[line.frequency_Hz] = Place("frequency_Hz", line.frequency_Hz, line.frequency_Hz, share, chance)
    return list(found.values())


def _places(cells: Sequence[Cells], unexplained: float) -> list[Place]:
    p_values = _stepped_down(cells)
    places = []
    for one, p in zip(cells, p_values, strict=True):
        for run in _runs(p <= LEVEL, one.kin):
            share = float(np.clip(one.energy[run].sum() / unexplained, 0.0, 1.0))
            if share < LEAST_SHARE:
                continue
            places.append(
                Place(one.axis, float(one.low[run].min()), float(one.high[run].max()), share, float(p[run].min()))
            )
    return places


def _stepped_down(cells: Sequence[Cells]) -> list[Array]:
    """Family-wise p of every cell, each axis on the scale of its own largest reference."""
    scaled = []
    for one in cells:
        largest = one.score[1:].max(axis=1)
        scaled.append((one.score - largest.mean()) / max(float(largest.std()), 1e-12))
    score = np.hstack(scaled)
    order = np.argsort(score[0])
    beyond = np.maximum.accumulate(score[1:, order], axis=1) >= score[0, order]
    p = (1.0 + beyond.sum(axis=0)) / score.shape[0]
    p = np.maximum.accumulate(p[::-1])[::-1]
    result = np.empty_like(p)
    result[order] = p
    return np.split(result, np.cumsum([one.low.size for one in cells])[:-1])


def _runs(hit: Mask, kin: Index) -> Iterator[Index]:
    """Stretches of neighbouring cells of the same kin that are hit."""
    places = np.flatnonzero(hit)
    if places.size:
        breaks = np.flatnonzero((np.diff(places) > 1) | (np.diff(kin[places]) != 0)) + 1
        yield from np.split(places, breaks)


def _without_repeats(places: Sequence[Place]) -> list[Place]:
    """The same without a place that lies in a larger one of the same axis with more in it; a line is no such place."""
    kept: list[Place] = []
    for place in sorted(places, key=lambda one: (-one.share, one.low - one.high)):
        beside = [one for one in kept if one.axis == place.axis and (place.low < place.high or one.low == one.high)]
        if not any(one.low <= place.low and place.high <= one.high for one in beside):
            kept.append(place)
    return kept


__all__ = ["Place", "locate"]
