"""Selection of the orders: fit every pair, compare the held-out errors in free run, take the smallest sufficient pair.

A pair is sufficient if its held-out error is within a standard error of the best one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.estimation.fit.columns import Samples, Structure
from piezod.estimation.fit.quadratic_program import Variant
from piezod.estimation.recordings.start import output_after
from piezod.identify.fit import Fit, fit_hysteresis
from piezod.identify.tables import dead_zone_rows, play_rows
from piezod.operators import PrandtlIshlinskii

PLAYS = (2, 4, 6, 8, 11, 14, 18, 23, 29)
ZONES = (0, 1, 2, 3, 4, 6, 8)
NEGLIGIBLE = 0.02  # share of the held-out mean square error, 1 % of the rms error
SMALLEST_SHARE_PRUNED = 0.1  # pruning ends below this share of the negligible operators
BLOCKS = 8  # blocks of each held-out stretch; their scatter gives the standard error


@dataclass(frozen=True)
class Candidate:
    """A pair of orders with its fit and errors."""

    plays: int  # order n
    zones: int  # order m
    fit: Fit | None  # None: the recordings do not determine it
    rms_fit: float  # rms_fit, rms_held_out: root mean square errors in free run [output unit]
    rms_held_out: float
    block_powers: Array  # mean square error of each held-out block [output unit^2]

    @property
    def size(self) -> int:
        """Number of weights besides the two linear parts."""
        return self.plays + self.zones


def residual(operator: PrandtlIshlinskii, samples: Samples) -> Array:
    """Measured minus simulated output in free run from the start of the samples, shape (N,) [output unit]."""
    error: Array = samples.y - output_after(operator, samples.path, samples.u)
    return error


def candidate_of(
    structure: Structure,
    plays: int,
    zones: int,
    fitted: Sequence[Samples],
    held_out: Sequence[Samples],
    variant: Variant,
    eps: float,
) -> Candidate:
    """Fit of a pair of orders with its errors; `counts` marks the fitted and the held-out samples."""
    try:
        fit = fit_hysteresis(structure, fitted, variant=variant, eps=eps)
    except RecordingError:
        return Candidate(plays, zones, None, np.inf, np.inf, np.array([np.inf]))
    operator = fit.hysteresis.operator()
    fit_power: list[Array] = []
    powers: list[float] = []
    for inside, outside in zip(fitted, held_out, strict=True):
        error = residual(operator, inside)
        fit_power.append(error[inside.counts] ** 2)
        if outside.counts.any():
            powers.extend(
                float(block.mean()) for block in np.array_split(error[outside.counts] ** 2, BLOCKS) if block.size
            )
    return Candidate(
        plays,
        zones,
        fit,
        float(np.sqrt(np.mean(np.concatenate(fit_power)))),
        float(np.sqrt(np.mean(powers))),
        np.array(powers),
    )


def choose(candidates: Sequence[Candidate]) -> Candidate:
    """Smallest candidate whose held-out error lies within one standard error of the best.

    The standard error belongs to the block-wise differences from the best candidate. A difference below 1 % of the rms
    error is always accepted. Raises as `best_of`.
    """
    best = best_of(candidates)
    good = (candidate for candidate in candidates if candidate.fit is not None and _as_good(candidate, best))
    return min(good, key=lambda c: (c.size, c.rms_held_out))


def best_of(candidates: Sequence[Candidate]) -> Candidate:
    """The candidate with the smallest held-out error; raises `RecordingError` if none has a fit."""
    usable = [candidate for candidate in candidates if candidate.fit is not None]
    if not usable:
        raise RecordingError("no order could be fitted: record triangles over the whole range, from rest")
    return min(usable, key=lambda candidate: candidate.rms_held_out)


def prune(
    chosen: Candidate,
    best: Candidate,
    fitted: Sequence[Samples],
    held_out: Sequence[Samples],
    *,
    variant: Variant,
    eps: float,
) -> Candidate:
    """Remove operators with negligible weights from the direct table and refit, while the held-out error allows it.

    First all negligible operators are removed. If the error grows too much, the smaller half of them is removed, and so
    on. The inverse is computed from the direct table, so both agree (piezod/operators/README.md, "Slopes and weights").
    The held-out error is compared with that of `best`.
    """
    share = 1.0
    while chosen.fit is not None and share > SMALLEST_SHARE_PRUNED:
        structure = _without_negligible(chosen.fit, share)
        if structure is None:
            break
        plays, zones = structure.plays - 1, structure.zones
        smaller = candidate_of(structure, plays, zones, fitted, held_out, variant, eps)
        if smaller.fit is not None and _as_good(smaller, best):
            chosen = smaller
        else:
            share *= 0.5
    return chosen


def _without_negligible(fit: Fit, share: float) -> Structure | None:
    """The structure without a share of its negligible operators; None if it has none.

    The linear parts stay. The zero of the direct table may be shifted, so its linear part may have another index than
    in the structure. Both indices are protected.
    """
    plays, zones = play_rows(fit.hysteresis), dead_zone_rows(fit.hysteresis)
    linear = 0, int(np.flatnonzero(fit.structure.zone_thresholds == 0.0)[0])
    steepest = [float(np.abs(np.cumsum([row.weight for row in rows])).max()) for rows in (plays, zones)]
    weak = [
        (abs(row.weight) / steepest[table], table, place)
        for table, rows in enumerate((plays, zones))
        for place, row in enumerate(rows)
        if not row.matters and row.index != 0 and place != linear[table]
    ]
    if not weak:
        return None
    removed = sorted(weak)[: max(1, round(share * len(weak)))]
    remaining_plays, remaining_zones = (
        np.delete(thresholds, [place for _, table, place in removed if table == number])
        for number, thresholds in enumerate((fit.structure.play_thresholds, fit.structure.zone_thresholds))
    )
    return replace(fit.structure, play_thresholds=remaining_plays, zone_thresholds=remaining_zones)


def _as_good(candidate: Candidate, best: Candidate) -> bool:
    """Whether the held-out error is within a standard error, or `NEGLIGIBLE`, of the best one."""
    difference = candidate.block_powers - best.block_powers
    standard_error = difference.std(ddof=1) / np.sqrt(difference.size) if difference.size > 1 else 0.0
    return bool(difference.mean() <= max(standard_error, NEGLIGIBLE * best.block_powers.mean()))
