"""Operators that hardly matter are dropped; the linear parts never are."""

from types import SimpleNamespace

import numpy as np

from piezod.estimation.fit.columns import Structure
from piezod.identify.order import _without_negligible
from piezod.model.parameters import Hysteresis, Superposition


def a_fit(zone_thresholds, direct_zones, direct_weights):
    structure = Structure(np.array([0.0, 10.0, 20.0]), np.array(zone_thresholds), 0.0, 100.0, 1.0)
    hysteresis = Hysteresis(
        plays=Superposition(thresholds=(0.0, 10.0, 20.0), weights=(0.7, 0.2, 0.1)),
        dead_zones=Superposition(thresholds=tuple(direct_zones), weights=tuple(direct_weights)),
        offset=0.0,
    )
    return SimpleNamespace(structure=structure, hysteresis=hysteresis)


def test_a_table_whose_zero_was_moved_does_not_lose_its_linear_part():
    fit = a_fit([0.0, 20.0, 40.0], [-20.0, 0.0, 20.0], [1e-9, 2.0, 1e-9])
    smaller = _without_negligible(fit, 1.0)
    assert smaller is not None
    assert 0.0 in smaller.zone_thresholds
    assert smaller.zone_thresholds.size < 3
    assert smaller.play_thresholds.size == 3


def test_an_operator_that_matters_is_not_pruned():
    assert _without_negligible(a_fit([0.0, 20.0, 40.0], [0.0, 20.0, 40.0], [2.0, 0.5, 0.4]), 1.0) is None
