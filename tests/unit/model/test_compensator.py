"""Compensators of a model without effects: plan and commit."""

from pathlib import Path

import numpy as np
import pytest

from piezod.model import DirectDrive, load_model, make_compensator, steady_range


@pytest.fixture(scope="module")
def model():
    return load_model(Path(__file__).parents[3] / "config" / "model.yaml")


def test_the_inverse_reaches_every_reachable_reference(model):
    plant, compensator = model.operator(), make_compensator("inverse", model, 1e-3)
    rng = np.random.default_rng(3)
    bottom, top = steady_range(model)
    for reference in rng.uniform(bottom + 0.2 * (top - bottom), bottom + 0.8 * (top - bottom), 500):
        voltage = compensator.plan(reference)
        compensator.commit(voltage)
        assert plant.step(voltage) == pytest.approx(reference, abs=1e-9 * (top - bottom))


def test_plan_changes_no_state(model):
    compensator = make_compensator("inverse", model, 1e-3)
    assert len({compensator.plan(100.0) for _ in range(5)}) == 1


def test_the_gain_passes_through_both_ends_of_the_steady_loop(model):
    gain = make_compensator("gain", model, 1e-3)
    bottom, top = steady_range(model)
    assert gain.plan(bottom) == pytest.approx(model.input.low, abs=1e-9)
    assert gain.plan(top) == pytest.approx(model.input.high, abs=1e-9)


def test_reset_returns_to_the_start_state(model):
    compensator = make_compensator("inverse", model, 1e-3)
    before = compensator.plan(50.0)
    compensator.commit(120.0)
    assert compensator.plan(50.0) != before
    compensator.reset()
    assert compensator.plan(50.0) == before


def test_a_direct_drive_is_the_identity():
    assert DirectDrive().plan(12.5) == 12.5
