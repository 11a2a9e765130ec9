"""Parameters as tables: the direct and the inverse operators, and which weights are negligible."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.model.parameters import Hysteresis
from piezod.operators.dead_zone import inverse_dead_zone, split
from piezod.operators.play import inverse_table

MATTERS = 0.01  # share of the steepest slope below which a weight is negligible


@dataclass(frozen=True)
class OperatorRow:
    """An operator in the direct and in the inverse model."""

    index: int
    threshold: float
    weight: float
    inverse_threshold: float
    inverse_weight: float
    matters: bool


def play_rows(hysteresis: Hysteresis) -> list[OperatorRow]:
    """Plays of the direct and the inverse model (3.28-3.30)."""
    thresholds, weights = np.array(hysteresis.plays.thresholds), np.array(hysteresis.plays.weights)
    inverse = inverse_table(thresholds, weights)
    return _rows(np.arange(thresholds.size), thresholds, weights, *inverse, float(np.cumsum(weights).max()))


def dead_zone_rows(hysteresis: Hysteresis) -> list[OperatorRow]:
    """Dead zones of the direct and the inverse model (3.31-3.36)."""
    thresholds, weights = np.array(hysteresis.dead_zones.thresholds), np.array(hysteresis.dead_zones.weights)
    inverse = inverse_dead_zone(thresholds, weights)
    steepest = max(float(np.cumsum(side[1]).max()) for side in split(thresholds, weights))
    index = np.arange(thresholds.size) - int(np.flatnonzero(thresholds == 0.0)[0])
    return _rows(index, thresholds, weights, *inverse, steepest)


def _rows(
    index: NDArray[np.integer],
    thresholds: Array,
    weights: Array,
    inverse_thresholds: Array,
    inverse_weights: Array,
    steepest: float,
) -> list[OperatorRow]:
    columns = (index, thresholds, weights, inverse_thresholds, inverse_weights)
    return [
        OperatorRow(int(i), float(r), float(w), float(inverse_r), float(inverse_w), bool(abs(w) >= MATTERS * steepest))
        for i, r, w, inverse_r, inverse_w in zip(*columns, strict=True)
    ]
