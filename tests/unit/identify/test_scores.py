"""The figures of merit, against loops whose opening is known."""

import numpy as np
import pytest

from piezod.identify.scores import largest, max_hysteresis_percent, nrmse_percent, rms
from piezod.operators import PrandtlIshlinskii


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
    assert max_hysteresis_percent(drive, 100 * drive + noise) < 0.15  # ten samples a cell


def test_a_drive_that_never_comes_back_has_no_loop():
    with pytest.raises(ValueError, match="must rise and fall"):
        max_hysteresis_percent(np.linspace(0, 1, 100), np.linspace(0, 1, 100))


def test_of_loops_of_several_sizes_the_widest_opening_counts():
    """A play of threshold 0.1, growing peaks: the first rise is the lowest branch, the last fall the highest."""
    drive = np.concatenate([peak * triangle(cycles=1) for peak in (0.4, 0.7, 1.0)])
    play = PrandtlIshlinskii([0.0, 0.1], [1e-6, 1.0], [0.0], [1.0], eps=1e-9)
    response = play.run(drive)
    assert max_hysteresis_percent(drive, response) == pytest.approx(100 * 0.2 / np.ptp(response), rel=0.02)
    response += np.where(np.arange(drive.size) < drive.size // 3, -0.05, 0.0)  # the first loop lies lower
    assert max_hysteresis_percent(drive, response) == pytest.approx(100 * 0.25 / np.ptp(response), rel=0.02)


def test_a_loop_that_the_response_leads_opens_as_far():
    t = np.linspace(0, 8 * np.pi, 20_000)
    assert max_hysteresis_percent(np.sin(t), np.sin(t + 0.1)) == pytest.approx(100 * np.sin(0.1), rel=0.03)


def test_small_reversals_of_a_noisy_drive_begin_no_branch():
    drive = triangle()
    noisy = drive + np.random.default_rng(2).normal(0, 1e-3, drive.size)
    response = 100 * drive + np.where(np.gradient(drive) > 0, -1.5, 1.5)
    assert max_hysteresis_percent(noisy, response) == pytest.approx(max_hysteresis_percent(drive, response), rel=0.05)
