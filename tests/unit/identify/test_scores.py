"""The figures of merit, against loops whose opening is known."""

import numpy as np
import pytest

from piezod.identify.scores import largest, max_hysteresis_percent, nrmse_percent, rms


def triangle(cycles=4, samples=2000):
    phase = np.linspace(0, cycles, cycles * samples + 1)
    return 1 - np.abs(2 * (phase % 1) - 1)


def test_rms_and_largest_of_a_known_signal():
    values = np.array([3.0, -4.0, 0.0, 0.0])
    assert rms(values) == pytest.approx(2.5)
    assert largest(values) == 4.0


def test_nrmse_is_100_for_the_same_and_0_for_the_mean():
    measured = np.array([1.0, 2.0, 4.0, 9.0])
    assert nrmse_percent(measured, measured) == 100.0
    assert nrmse_percent(measured, np.full(4, measured.mean())) == pytest.approx(0.0)


def test_a_parallel_loop_has_the_opening_it_was_given():
    drive = triangle()
    response = 100 * drive + np.where(np.gradient(drive) > 0, -1.5, 1.5)
    expected = 100 * 3.0 / (response.max() - response.min())
    assert max_hysteresis_percent(drive, response) == pytest.approx(expected, rel=0.02)


def test_an_ellipse_opens_as_its_phase_says():
    """y = sin(t - p) over x = sin(t): the opening at x is 2 sin(p) cos(asin x), at most 2 sin(p) of a range of 2."""
    t = np.linspace(0, 8 * np.pi, 20_000)
    drive, response = np.sin(t), np.sin(t - 0.1)
    assert max_hysteresis_percent(drive, response) == pytest.approx(100 * np.sin(0.1), rel=0.03)


def test_a_straight_line_has_none_and_noise_is_averaged_away():
    drive = triangle(cycles=10)
    noise = np.random.default_rng(1).normal(0, 0.1, drive.size)
    assert max_hysteresis_percent(drive, 100 * drive) < 0.02
    assert max_hysteresis_percent(drive, 100 * drive + noise) < 0.1


def test_a_drive_that_never_comes_back_has_no_loop():
    with pytest.raises(ValueError, match="must rise and fall"):
        max_hysteresis_percent(np.linspace(0, 1, 100), np.linspace(0, 1, 100))
