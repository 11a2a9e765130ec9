"""Places at which a residual exceeds noise: voltages, rates, forces, times, frequencies and memories.

Every axis is divided into cells with a score. A step-down maxT test over all cells of all axes keeps the probability of
a false place at 5 % (P. Westfall and S. Young (1993), Resampling-Based Multiple Testing). References of the scores:

- Drive and coherence with the model: the residual, shifted circularly by a random time within each recording. A second
  reference also draws the sign of each block and subtracts the slow part. A shift alone does not test a periodic
  residual over a periodic drive.
- Time and temperature: independent cells with the spread of neighbouring cells, since no shift changes that spread.
- Lines: Gaussian noise with the spectrum around the line, since no shift changes a line's power.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from piezod.arrays import Array, Index, Mask
from piezod.diagnose.candidates.direct import lines
from piezod.diagnose.findings import Place
from piezod.diagnose.localisation.cells import Cells, NormalisedResidual
from piezod.diagnose.localisation.drive_cells import cells_of_drive
from piezod.diagnose.localisation.time_cells import cells_of_lines, cells_of_time_and_temperature
from piezod.estimation.recordings.series import Series

LEVEL = 0.05  # family-wise probability of a false place
LINE_DISTANCE_HZ = 0.1  # distance below which lines of two recordings are one line
LEAST_SHARE = 0.005  # share of the unexplained energy below which a place is not reported
LEAST_EXCESS = 0.02  # lower limit of the unexplained energy, relative to the residual's energy


def locate(
    series: Sequence[Series],
    residuals: Sequence[Array],
    modelled: Sequence[Array],
    *,
    shifts: int = 99,
) -> list[Place]:
    """Find the places at which the residuals of the diagnosed recordings exceed noise, the largest share first.

    `residuals` and `modelled` have shape (N,) each [N]. With `shifts` references the least p-value is 1 / (1 + shifts).
    Places in time refer to the time of each recording.
    """
    recordings = NormalisedResidual.diagnosed(series, residuals, modelled)
    if not any(recording.residual.any() for recording in recordings):
        return []
    rng = np.random.default_rng(0)
    cells = [
        *cells_of_drive(recordings, shifts, rng),
        *cells_of_time_and_temperature(recordings, shifts, rng),
        *cells_of_lines(recordings, shifts, rng),
    ]
    total = sum(float(recording.residual @ recording.residual) for recording in recordings)
    noise = sum(float(np.count_nonzero(recording.series.counts)) for recording in recordings)
    unexplained = max(total - noise, LEAST_EXCESS * total)
    places = _without_contained([*_places(cells, unexplained), *_lines(recordings, unexplained)])
    return sorted(places, key=lambda place: -place.share)


def _lines(recordings: Sequence[NormalisedResidual], unexplained: float) -> list[Place]:
    """Lines so strong that they need no reference; a line of several recordings is one place."""
    places: dict[float, Place] = {}
    for recording in recordings:
        for line in lines(recording.series, recording.residual):
            energy = 0.5 * line.amplitude_N**2 * float(np.count_nonzero(recording.series.counts))
            share = float(np.clip(energy / unexplained, 0.0, 1.0))
            p = min(1.0, 0.5 * recording.residual.size * 0.5**line.over_median)  # of exponential noise in all bins
            is_known = any(abs(f - line.frequency_Hz) < LINE_DISTANCE_HZ for f in places)
            if share >= LEAST_SHARE and p <= LEVEL and not is_known:
                places[line.frequency_Hz] = Place("frequency_Hz", line.frequency_Hz, line.frequency_Hz, share, p)
    return list(places.values())


def _places(cells: Sequence[Cells], unexplained: float) -> list[Place]:
    places = []
    for axis, p in zip(cells, _family_wise_p(cells), strict=True):
        for run in _runs(p <= LEVEL, axis.kind):
            share = float(np.clip(axis.energy[run].sum() / unexplained, 0.0, 1.0))
            if share >= LEAST_SHARE:
                low, high = float(axis.low[run].min()), float(axis.high[run].max())
                places.append(Place(axis.axis, low, high, share, float(p[run].min())))
    return places


def _family_wise_p(cells: Sequence[Cells]) -> list[Array]:
    """Family-wise p-value of every cell; each axis is scaled by the largest scores of its references."""
    scaled = []
    for axis in cells:
        largest = axis.score[1:].max(axis=1)
        scaled.append((axis.score - largest.mean()) / max(float(largest.std()), 1e-12))
    score = np.hstack(scaled)
    order = np.argsort(score[0])
    beyond = np.maximum.accumulate(score[1:, order], axis=1) >= score[0, order]
    p = (1.0 + beyond.sum(axis=0)) / score.shape[0]
    p = np.maximum.accumulate(p[::-1])[::-1]
    result = np.empty_like(p)
    result[order] = p
    return np.split(result, np.cumsum([axis.low.size for axis in cells])[:-1])


def _runs(significant: Mask, kind: Index) -> Iterator[Index]:
    """Runs of neighbouring significant cells of one kind."""
    cells = np.flatnonzero(significant)
    if cells.size:
        breaks = np.flatnonzero((np.diff(cells) > 1) | (np.diff(kind[cells]) != 0)) + 1
        yield from np.split(cells, breaks)


def _without_contained(places: Sequence[Place]) -> list[Place]:
    """Places without those inside a range of the same axis with a larger share; a line inside a range stays."""
    result: list[Place] = []
    for place in sorted(places, key=lambda place: (-place.share, place.low - place.high)):
        others = [p for p in result if p.axis == place.axis and (place.low < place.high or p.low == p.high)]
        if not any(other.low <= place.low and place.high <= other.high for other in others):
            result.append(place)
    return result
