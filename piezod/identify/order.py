"""How many operators: grow both tables, judge each in free run on data held out, take the smallest that will do."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError
from piezod.identify.columns import Samples, Structure
from piezod.identify.fit import Fit, fit_hysteresis
from piezod.identify.qp import Variant
from piezod.operators import PrandtlIshlinskii

Array = NDArray[np.float64]

PLAYS = (2, 4, 6, 8, 11, 14, 18, 23, 29)
ZONES = (0, 1, 2, 3, 4, 6, 8)
NEGLIGIBLE = 0.02  # share of the held-out power, one percent of rms error
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
    usable = [candidate for candidate in candidates if candidate.fit is not None]
    if not usable:
        raise RecordingError("no order could be fitted: record triangles over the whole range, from rest")
    best = min(usable, key=lambda candidate: candidate.rms_held_out)
    return min((candidate for candidate in usable if _as_good(candidate, best)), key=lambda c: (c.size, c.rms_held_out))


def _as_good(candidate: Candidate, best: Candidate) -> bool:
    difference = candidate.block_powers - best.block_powers
    standard_error = difference.std(ddof=1) / np.sqrt(difference.size) if difference.size > 1 else 0.0
    return bool(difference.mean() <= max(standard_error, NEGLIGIBLE * best.block_powers.mean()))
