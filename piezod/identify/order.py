"""How many operators: grow both tables, judge each in free run on data held out, take the smallest that will do."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError
from piezod.estimation.columns import Samples, Structure
from piezod.estimation.quadratic_program import Variant
from piezod.identify.fit import Fit, fit_hysteresis
from piezod.identify.tables import dead_zone_rows, play_rows
from piezod.operators import PrandtlIshlinskii

Array = NDArray[np.float64]

PLAYS = (2, 4, 6, 8, 11, 14, 18, 23, 29)
ZONES = (0, 1, 2, 3, 4, 6, 8)
NEGLIGIBLE = 0.02  # share of the held-out power, one percent of rms error
SMALLEST_SHARE_PRUNED = 0.1  # of the operators that hardly matter; below it pruning ends
BLOCKS = 8  # of each held-out stretch; their scatter is the standard error


@dataclass(frozen=True)
class Candidate:
    """One pair of orders and its errors, in the output's unit.

    Parameters
    ----------
    plays, zones
        n and m.
    fit
        What was found; None when the recording does not determine it.
    rms_fit, rms_held_out
        Root mean square errors in free run.
    block_powers
        Mean square error of each held-out block.
    """

    plays: int
    zones: int
    fit: Fit | None
    rms_fit: float
    rms_held_out: float
    block_powers: Array

    @property
    def size(self) -> int:
        """Number of weights besides the two linear parts."""
        return self.plays + self.zones


def residual(operator: PrandtlIshlinskii, samples: Samples) -> Array:
    """Measured minus simulated over the whole stretch, free run from the stretch's own start, shape (N,)."""
    operator.set_states(np.zeros(operator.plays[0].size))
    operator.run(np.array(samples.path))
    error: Array = samples.y - operator.run(samples.u)
    return error


def judge_orders(
    structure_of: Callable[[int, int], Structure],
    fitted: Sequence[Samples],
    held_out: Sequence[Samples],
    *,
    orders: Sequence[tuple[int, int]],
    variant: Variant,
    eps: float,
) -> list[Candidate]:
    """Fit every pair of orders and judge it on the held-out stretches.

    Parameters
    ----------
    structure_of
        Thresholds for n plays and m dead zones.
    fitted, held_out
        The same recordings with other samples counting.
    orders
        Pairs (n, m).
    variant, eps
        Constraints of the quadratic program.
    """
    return [_judge(structure_of(n, m), n, m, fitted, held_out, variant, eps) for n, m in orders]


def _judge(
    structure: Structure,
    plays: int,
    zones: int,
    fitted: Sequence[Samples],
    held_out: Sequence[Samples],
    variant: Variant,
    eps: float,
) -> Candidate:
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

    The standard error is that of the paired differences to the best one, block by block; less than one percent of rms
    error is nothing to a bench, however certain.

    Raises
    ------
    RecordingError
        None could be fitted.
    """
    best = best_of(candidates)
    good = (candidate for candidate in candidates if candidate.fit is not None and _as_good(candidate, best))
    return min(good, key=lambda c: (c.size, c.rms_held_out))


def best_of(candidates: Sequence[Candidate]) -> Candidate:
    """The one with the smallest held-out error.

    Raises
    ------
    RecordingError
        None could be fitted.
    """
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
    """Drop operators that hardly matter from the direct table and refit, as long as the held-out error allows it.

    The smallest weights go first, all that hardly matter at once; where that costs too much, half of them. The inverse
    is computed from the direct table, so that both agree (piezod/operators/README.md, "Slopes and weights").

    Parameters
    ----------
    chosen
        What `choose` took.
    best
        Whose held-out error is the measure.
    fitted, held_out, variant, eps
        As for `judge_orders`.
    """
    share = 1.0
    while chosen.fit is not None and share > SMALLEST_SHARE_PRUNED:
        structure = _without_the_least(chosen.fit, share)
        if structure is None:
            break
        plays, zones = structure.plays - 1, structure.zones
        smaller = _judge(structure, plays, zones, fitted, held_out, variant, eps)
        if smaller.fit is not None and _as_good(smaller, best):
            chosen = smaller
        else:
            share *= 0.5
    return chosen


def _without_the_least(fit: Fit, share: float) -> Structure | None:
    """The structure without a share of the operators that hardly matter; None where all matter.

    The linear parts stay. A direct table whose zero was moved may have its linear part in another place than the
    structure, so both are asked.
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
    gone = sorted(weak)[: max(1, round(share * len(weak)))]
    kept_plays = np.delete(fit.structure.play_thresholds, [place for _, table, place in gone if table == 0])
    kept_zones = np.delete(fit.structure.zone_thresholds, [place for _, table, place in gone if table == 1])
    return replace(fit.structure, play_thresholds=kept_plays, zone_thresholds=kept_zones)


def _as_good(candidate: Candidate, best: Candidate) -> bool:
    difference = candidate.block_powers - best.block_powers
    standard_error = difference.std(ddof=1) / np.sqrt(difference.size) if difference.size > 1 else 0.0
    return bool(difference.mean() <= max(standard_error, NEGLIGIBLE * best.block_powers.mean()))
