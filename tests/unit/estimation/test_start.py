"""The start of a recording amid the range, on a stack whose past is known."""

from pathlib import Path

import numpy as np
import pytest

from piezod.estimation.recordings.start import clipped_mean_square, estimate_path
from piezod.model import load_model

MODEL = load_model(Path(__file__).parents[3] / "config" / "model.yaml")
TIME_s = np.arange(4000) / 200.0
INPUT_V = 70.0 + 70.0 * np.sin(2.0 * np.pi * 0.3 * TIME_s)


def after(past):
    operator = MODEL.hysteresis.operator()
    operator.run(np.array(past))
    return operator.run(INPUT_V)


@pytest.mark.parametrize("follows_a_jump", [False, True])
@pytest.mark.parametrize("noise_N", [0.0, 1e-6, 0.1])
@pytest.mark.parametrize("past", [(0.0, 70.0), (140.0, 70.0), (140.0, 0.0, 70.0)])
def test_the_past_of_a_stack_is_found_with_and_without_noise_and_behind_a_jump(past, noise_N, follows_a_jump):
    force_N = after(past)
    measured_N = force_N + noise_N * np.random.default_rng(0).normal(size=force_N.size)
    if follows_a_jump:  # an amplifier that still rises from zero, with 12 ms
        measured_N -= force_N[0] * np.exp(-TIME_s / 0.012)
    found = estimate_path(MODEL.hysteresis.operator(), INPUT_V, measured_N, force_N.size)
    assert np.abs(after(found) - force_N).max() < 0.01 * np.ptp(force_N)


def test_a_part_without_readings_says_nothing_of_the_past():
    nothing = np.full(5, np.nan)
    assert clipped_mean_square(nothing, nothing) == 0.0


def test_a_large_error_is_clipped_at_ten_medians_and_at_a_hundredth_of_the_swing():
    y = np.linspace(0.0, 1.0, 11)
    error = np.full(11, 0.01)
    error[0] = 5.0
    assert clipped_mean_square(error, y) == pytest.approx((10 * 0.01**2 + 0.1**2) / 11)
    error[1:] = 0.0
    assert clipped_mean_square(error, y) == pytest.approx(0.01**2 / 11)
