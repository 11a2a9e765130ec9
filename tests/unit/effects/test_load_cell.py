"""Leakage, filter, feedthrough and hum against their closed forms."""

import numpy as np
import pytest

from piezod.recording.hold import Hold

from .records import forward, opening, triangle

HELD = Hold("held", 1e-9)  # read at once after its command

DT_s = 1e-3


@pytest.mark.parametrize(("f_tau", "percent"), [(10.0, 1.25), (20.0, 0.625)])
def test_leakage_opens_the_loop_by_12_5_over_f_tau_percent(f_tau, percent):
    frequency_Hz, dt_s = 1.0, 5e-3
    force = triangle(frequency_Hz, dt_s, 15 * f_tau)
    read = forward("charge_leakage", force, dt_s, {"time_constant_s": f_tau / frequency_Hz})
    assert 100.0 * opening(force, read, 200) == pytest.approx(percent, rel=0.01)


def test_leakage_turns_the_loop_clockwise():
    force = triangle(1.0, DT_s, 50)
    read = forward("charge_leakage", force, DT_s, {"time_constant_s": 5.0})
    assert read[-751] > read[-251]  # at half the force: going up, then coming down


def test_a_held_force_decays_to_its_start_with_the_time_constant():
    force = np.full(5001, 50.0)
    force[0] = 10.0
    read = forward("charge_leakage", force, DT_s, {"time_constant_s": 2.0}, hold=HELD)
    assert read[1] == pytest.approx(50.0)
    assert read[2001] == pytest.approx(10.0 + 40.0 * np.exp(-1.0), rel=1e-9)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_a_filter_passes_its_cutoff_at_minus_3_dB(order):
    cutoff_Hz, dt_s = 5.0, 1e-4
    t = np.arange(100_000) * dt_s
    out = forward("sensor_filter", np.sin(2.0 * np.pi * cutoff_Hz * t), dt_s, {"cutoff_Hz": cutoff_Hz, "order": order})
    line = 2.0 * np.mean(out[-20_000:] * np.exp(-2j * np.pi * cutoff_Hz * t[-20_000:]))
    assert abs(line) == pytest.approx(np.sqrt(0.5), rel=1e-5)
    assert np.angle(line * 1j) == pytest.approx(-np.pi / 4.0 * order, abs=1e-4)


@pytest.mark.parametrize("damping_ratio", [0.5, 0.6, np.sqrt(0.75), 1.0, 1.2])
def test_a_filter_of_second_order_passes_its_cutoff_at_minus_3_dB_however_damped(damping_ratio):
    cutoff_Hz, dt_s = 5.0, 1e-4
    t = np.arange(100_000) * dt_s
    values = {"cutoff_Hz": cutoff_Hz, "order": 2.0, "damping_ratio": damping_ratio}
    out = forward("sensor_filter", np.sin(2.0 * np.pi * cutoff_Hz * t), dt_s, values)
    line = 2.0 * np.mean(out[-20_000:] * np.exp(-2j * np.pi * cutoff_Hz * t[-20_000:]))
    assert abs(line) == pytest.approx(np.sqrt(0.5), rel=1e-5)


@pytest.mark.parametrize(("order", "fall"), [(1.0, 1.0 / 20.0), (2.0, 1.0 / 400.0)])
def test_a_filter_falls_with_the_frequency_to_its_order(order, fall):
    cutoff_Hz, dt_s = 1.0, 1e-4
    t = np.arange(60_000) * dt_s
    out = forward("sensor_filter", np.sin(40.0 * np.pi * t), dt_s, {"cutoff_Hz": cutoff_Hz, "order": order})
    line = 2.0 * np.mean(out[-10_000:] * np.exp(-40j * np.pi * t[-10_000:]))
    assert abs(line) == pytest.approx(fall, rel=0.01)


def test_the_drive_adds_a_square_wave_to_a_triangle():
    u = triangle(1.0, DT_s, 2, peak=100.0)
    force = np.full(u.size, 30.0)
    square_wave = forward("feedthrough", force, DT_s, {"coefficient_N_s_per_V": 0.01}, applied_V=u) - 30.0
    np.testing.assert_allclose(square_wave[1:501], 2.0)
    np.testing.assert_allclose(square_wave[501:1001], -2.0)


def test_a_band_limited_feedthrough_has_risen_by_63_percent_after_its_rise():
    u = 200.0 * np.arange(200) * DT_s
    values = {"coefficient_N_s_per_V": 0.01, "rise_s": 0.05}
    added = forward("feedthrough", 0.0 * u, DT_s, values, applied_V=u)
    assert added[50] == pytest.approx(2.0 * (1.0 - np.exp(-1.0)), rel=1e-9)


def test_hum_has_its_line_and_the_harmonics_it_is_given():
    values = {
        "amplitude_N": 0.4,
        "frequency_Hz": 50.0,
        "phase_rad": 0.7,
        "sine_3": 0.5,
        "cosine_3": 0.5,
        "cosine_5": 0.1,
    }
    added = forward("mains_hum", np.full(1000, 12.0), DT_s, values) - 12.0
    spectrum = 2.0 * np.abs(np.fft.rfft(added)) / added.size
    np.testing.assert_allclose(spectrum[[50, 100, 150, 250]], [0.4, 0.0, 0.4 * np.sqrt(0.5), 0.04], atol=1e-9)
    assert np.delete(spectrum, [50, 150, 250]).max() < 1e-9
