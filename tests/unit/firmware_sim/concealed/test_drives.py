"""The records that a plant is driven with."""

import numpy as np
import pytest

from firmware_sim.concealed.plant.drives import PIECES, identification_voltage, mixed_work


@pytest.mark.parametrize("seed", range(5))
def test_identification_starts_at_rest_is_slow_and_covers_the_range(seed):
    voltage_V = identification_voltage(np.random.default_rng(seed), 120.0, 500.0, 60.0)
    assert voltage_V.size == 30_000
    assert voltage_V[0] == 0.0
    assert voltage_V.max() == pytest.approx(120.0, abs=1.0)
    assert voltage_V.min() >= 0.0
    assert np.abs(np.diff(voltage_V)).max() * 500.0 <= 120.0
    assert np.count_nonzero(np.diff(np.sign(np.diff(voltage_V))) != 0) > 10


@pytest.mark.parametrize("seed", range(5))
def test_mixed_work_starts_at_rest_and_stays_within_the_range(seed):
    voltage_V = mixed_work(np.random.default_rng(seed), 120.0, 500.0, 60.0, np.inf)
    assert voltage_V.size == 30_000
    assert voltage_V[0] == 0.0
    assert voltage_V.min() >= 0.0
    assert voltage_V.max() <= 120.0
    assert np.ptp(voltage_V) > 80.0


def test_gentle_work_keeps_its_rate():
    voltage_V = mixed_work(np.random.default_rng(1), 120.0, 500.0, 60.0, 300.0)
    assert np.abs(np.diff(voltage_V)).max() * 500.0 <= 300.0 + 1e-6


@pytest.mark.parametrize("kind", PIECES)
def test_every_piece_is_finite_and_moves(kind):
    for seed in range(20):
        piece = PIECES[kind](np.random.default_rng(seed), np.arange(2000) / 500.0, 500.0)
        assert np.isfinite(piece).all()
        assert np.ptp(piece) > 0.0
