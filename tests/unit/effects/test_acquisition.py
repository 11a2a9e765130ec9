"""Delay, clocks, frozen readings and quantisation against their definitions."""

import numpy as np
import pytest

from .records import forward, opening, triangle

DT_s = 1e-3


@pytest.mark.parametrize("delay_s", [0.0, 0.0004, 0.001, 0.0123])
def test_a_delayed_ramp_is_the_ramp_shifted_in_time(delay_s):
    force = 50.0 * np.arange(200) * DT_s
    late = forward("transport_delay", force, DT_s, {"delay_s": delay_s})
    np.testing.assert_allclose(late, np.maximum(force - 50.0 * delay_s, 0.0), atol=1e-12)


def test_a_delay_opens_the_loop_by_400_f_delay_percent_and_keeps_its_corners():
    force = triangle(1.0, DT_s, 3)
    late = forward("transport_delay", force, DT_s, {"delay_s": 0.005})
    assert 100.0 * opening(force, late, 1000) == pytest.approx(2.0, rel=1e-9)
    assert late.max() == force.max()


def test_a_delay_longer_than_the_record_shows_its_first_value():
    force = np.linspace(3.0, 9.0, 50)
    assert (forward("transport_delay", force, DT_s, {"delay_s": 0.5}) == 3.0).all()


@pytest.mark.parametrize("skew_ppm", [-1000.0, 1000.0])
def test_a_skewed_clock_stretches_a_ramp_by_parts_in_a_million(skew_ppm):
    force = 50.0 * np.arange(2001) * DT_s
    read = forward("clock_skew", force, DT_s, {"skew_ppm": skew_ppm})
    np.testing.assert_allclose(read[:1990], force[:1990] * (1.0 + 1e-6 * skew_ppm), rtol=1e-12)


def test_a_frozen_reading_keeps_the_value_of_its_first_instant_and_then_follows_the_force():
    force = 50.0 * np.arange(100) * DT_s
    read = forward("sensor_dropout", force, DT_s, {"from_s": 0.0405, "to_s": 0.07})
    np.testing.assert_allclose(read[41:70], 50.0 * 0.0405)
    np.testing.assert_array_equal(np.delete(read, np.s_[41:70]), np.delete(force, np.s_[41:70]))


def test_a_reading_frozen_from_the_start_keeps_its_first_value_and_an_empty_stretch_freezes_nothing():
    force = np.linspace(3.0, 9.0, 50)
    assert (forward("sensor_dropout", force, DT_s, {"from_s": 0.0, "to_s": 1e7}) == 3.0).all()
    assert np.array_equal(forward("sensor_dropout", force, DT_s, {"from_s": 0.03, "to_s": 0.01}), force)


def test_readings_are_multiples_of_the_step_and_at_most_half_a_step_off():
    force = np.random.default_rng(1).uniform(-20.0, 80.0, 5000)
    read = forward("quantisation", force, DT_s, {"step_N": 0.3, "offset_N": 0.1})
    multiples = (read - 0.1) / 0.3
    np.testing.assert_allclose(multiples, np.round(multiples), atol=1e-9)
    assert np.abs(read - force).max() <= 0.15 + 1e-12
    assert np.std(read - force) == pytest.approx(0.3 / np.sqrt(12.0), rel=0.03)
