"""Each effect's parameter, read off noise-free answers of a plant that has a closed form."""

import numpy as np
import pytest

from firmware_sim.concealed.plant.creep import LAWS, curve, slope_per_decade
from firmware_sim.concealed.plant.force_law import BENDS, amount_for_curvature, bend, curvature
from firmware_sim.concealed.plant.friction import friction_force
from firmware_sim.concealed.plant.sampling import frozen, quantised
from firmware_sim.concealed.plant.stroke import DRIFT_SHAPES, drift_progress
from tests.unit.firmware_sim.concealed.benches import (
    FULL_N,
    RATE_HZ,
    REACH_V,
    drive,
    effect,
    forces,
    hold,
    opening_percent,
    play_plant,
    straight_plant,
    triangles,
)

N_PER_V = FULL_N / REACH_V


def answer(voltage_V, **effects):
    return forces(straight_plant(), drive(voltage_V), **effects)


def shift_s(force_N, plain_N):
    """By how much one record is later than another, on a steady rise."""
    middle = slice(force_N.size // 2, 9 * force_N.size // 10)
    time_s = np.arange(force_N.size) / RATE_HZ
    return np.mean((time_s - np.interp(force_N, plain_N, time_s))[middle])


def line_Hz(force_N):
    """Frequency of the strongest line, to a small part of a bin."""
    window = np.hanning(force_N.size)
    size = 8 * force_N.size
    spectrum = np.abs(np.fft.rfft((force_N - force_N.mean()) * window, size))
    return np.argmax(spectrum) * RATE_HZ / size


def amplitude_at(force_N, frequency_Hz):
    """Amplitude of a line of known frequency."""
    angle = 2 * np.pi * frequency_Hz * np.arange(force_N.size) / RATE_HZ
    return np.hypot(*np.linalg.lstsq(np.column_stack([np.sin(angle), np.cos(angle)]), force_N, rcond=None)[0])


def test_the_plant_without_effects_is_straight():
    voltage_V = triangles(0.5, 2)
    assert answer(voltage_V) == pytest.approx(N_PER_V * voltage_V, abs=1e-9)


@pytest.mark.parametrize("tau_s", [0.002, 0.01])
def test_a_lag_opens_a_triangle_by_400_f_tau_percent(tau_s):
    voltage_V = triangles(1.0, 6)
    force_N = answer(voltage_V, **effect("electrical_lag", {"swell": 0.0}, time_constant_s=tau_s))
    assert opening_percent(voltage_V, force_N, 1.0, FULL_N) == pytest.approx(400.0 * tau_s, rel=1e-3)


def test_a_swelling_lag_has_its_time_constant_at_half_range():
    voltage_V = 50.0 + 2.0 * triangles(1.0, 6, peak_V=1.0)
    on = effect("electrical_lag", {"swell": 0.05}, time_constant_s=0.01)
    assert shift_s(answer(np.linspace(48.0, 52.0, 8000), **on), answer(np.linspace(48.0, 52.0, 8000))) == pytest.approx(
        0.01, rel=0.01
    )
    assert opening_percent(voltage_V - 50.0, answer(voltage_V, **on), 1.0, 2 * N_PER_V) == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize("delay_s", [0.004, 0.0073])
def test_a_delay_moves_the_answer_without_changing_it(delay_s):
    noise_V = np.convolve(np.random.default_rng(1).uniform(0, 100, 6000), np.hanning(80) / 40, "same")
    voltage_V = np.concatenate([hold(0, 0.5), noise_V * np.hanning(6000), hold(0, 0.5)])
    plain, late = answer(voltage_V), answer(voltage_V, **effect("transport_delay", delay_s=delay_s))
    time_s = np.arange(voltage_V.size) / RATE_HZ
    assert late[200:-200] == pytest.approx(np.interp(time_s - delay_s, time_s, plain)[200:-200], abs=0.05)
    spectrum = np.fft.rfft(late) / np.fft.rfft(plain)
    f = np.fft.rfftfreq(plain.size, 1 / RATE_HZ)
    assert np.polyfit(f[20:60], np.unwrap(np.angle(spectrum[20:60])), 1)[0] == pytest.approx(
        -2 * np.pi * delay_s, rel=0.02
    )


def test_a_late_clock_is_later_in_proportion_to_time():
    voltage_V = np.linspace(0.0, 90.0, 20_000)
    force_N = answer(voltage_V, **effect("clock_skew", skew_ppm=400.0))
    time_s = np.arange(voltage_V.size) / RATE_HZ
    assert force_N == pytest.approx(np.interp(time_s * 1.0004, time_s, N_PER_V * voltage_V), abs=1e-2)


def test_a_slew_limit_makes_a_ramp_of_a_step_and_lets_slower_ones_pass():
    on = effect("slew_limit", limit_V_per_s=500.0)
    stepped = answer(np.concatenate([hold(0.0, 0.1), hold(90.0, 0.5)]), **on)
    assert np.diff(stepped).max() * RATE_HZ == pytest.approx(500.0 * N_PER_V, rel=1e-3)
    assert stepped[-1] == pytest.approx(180.0, abs=1e-3)
    slow_V = triangles(2.0, 2)
    assert answer(slow_V, **on) == pytest.approx(N_PER_V * slow_V, abs=0.05)


@pytest.mark.parametrize("held", [False, True])
def test_a_held_command_is_answered_alike_with_a_lag_that_is_nothing(held):
    voltage_V = np.repeat(np.arange(0.0, 100.0, 5.0), 10)
    record = drive(voltage_V, held=held, late=0.5 if held else 0.0)
    plain = forces(straight_plant(), record)
    short = forces(straight_plant(), record, **effect("electrical_lag", {"swell": 0.0}, time_constant_s=2e-5))
    assert short == pytest.approx(plain, abs=1.5)
    assert plain == pytest.approx(N_PER_V * voltage_V, abs=1e-9)


def test_a_clamp_is_flat_above_its_limit_and_nothing_below():
    voltage_V = triangles(1.0, 1)
    force_N = answer(voltage_V, **effect("voltage_clamp", {"knee_V": 0.1}, limit_V=80.0))
    assert force_N[voltage_V > 81.0] == pytest.approx(80.0 * N_PER_V, abs=0.02)
    assert force_N[voltage_V < 79.0] == pytest.approx(N_PER_V * voltage_V[voltage_V < 79.0], abs=0.02)


@pytest.mark.parametrize("rate_V_per_s", [20.0, 2000.0])
def test_a_play_widens_with_the_rate(rate_V_per_s):
    frequency_Hz = rate_V_per_s / 200.0
    voltage_V = triangles(frequency_Hz, 3)
    on = effect("rate_dependent_hysteresis", growth=0.05, reference_V_per_s=10.0)
    force_N = forces(play_plant(), drive(voltage_V), **on)
    wide = 1.0 + 0.05 * np.arcsinh(rate_V_per_s / 10.0)
    plain = opening_percent(voltage_V, forces(play_plant(), drive(voltage_V)), frequency_Hz, FULL_N)
    assert plain == pytest.approx(20.0, rel=1e-3)
    assert opening_percent(voltage_V, force_N, frequency_Hz, FULL_N) == pytest.approx(20.0 * wide, rel=5e-3)


def test_a_widened_play_rests_while_the_voltage_rests():
    voltage_V = np.concatenate([np.linspace(0, 90, 50), hold(90.0, 1.0), np.linspace(90, 40, 30), hold(40.0, 1.0)])
    on = effect("rate_dependent_hysteresis", growth=0.1, reference_V_per_s=5.0)
    force_N = forces(play_plant(), drive(voltage_V), **on)
    assert np.ptp(force_N[60:1040]) == 0.0
    assert np.ptp(force_N[1090:]) == 0.0


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("shape", [0.0, 1.0])
def test_creep_climbs_in_a_hold_by_its_slope_per_decade(law, shape):
    voltage_V = np.concatenate([hold(0.0, 0.1), hold(80.0, 30.0)])
    details = {"law": law, "shape": shape}
    force_N = answer(voltage_V, **effect("creep", details, per_decade=0.02, from_s=0.05, to_s=25.0))
    after_s = np.arange(voltage_V.size) / RATE_HZ - 0.1
    at_s = np.geomspace(0.05, 25.0, 60)
    slope = np.polyfit(np.log10(at_s), np.interp(at_s, after_s, force_N), 1)[0]
    assert slope / 160.0 == pytest.approx(0.02, rel=0.01)
    assert force_N[101] / 160.0 - 1.0 < 0.01
    response = curve(law, shape, 0.05, 25.0)
    assert (np.diff(response(np.geomspace(1e-3, 1e3, 200))) > 0.0).all()
    assert slope_per_decade(response, 0.05, 25.0) == pytest.approx(1.0)


def test_creep_superposes_what_came_before():
    up, down = np.concatenate([hold(0, 0.1), hold(50, 2)]), np.concatenate([hold(0, 1.1), hold(30, 1)])
    on = effect("creep", {"law": "logarithmic", "shape": 0.0}, per_decade=0.02, from_s=0.05, to_s=25.0)
    assert answer(up + down, **on) == pytest.approx(answer(up, **on) + answer(down, **on), abs=1e-8)


@pytest.mark.parametrize("kind", DRIFT_SHAPES)
@pytest.mark.parametrize("bent", [0.0, 0.5, 1.0])
def test_a_drifting_gain_changes_by_its_change_from_beginning_to_end(kind, bent):
    on = effect("gain_drift", {"course": kind, "bend": bent}, relative_change=-0.04)
    force_N = answer(hold(100.0, 3.0), **on)
    assert force_N[-1] / force_N[0] - 1.0 == pytest.approx(-0.04, rel=1e-3)
    assert (np.diff(drift_progress(kind, bent, np.linspace(0.0, 1.0, 50))) > 0.0).all()


@pytest.mark.parametrize("shape", BENDS)
@pytest.mark.parametrize("wanted", [-0.2, 0.05, 0.25])
def test_a_bend_has_the_curvature_of_the_nearest_parabola(shape, wanted):
    voltage_V = np.linspace(0.0, 100.0, 2001)
    force_N = answer(voltage_V, **effect("output_nonlinearity", {"shape": shape}, curvature=wanted)) / FULL_N
    x = voltage_V / REACH_V
    slope, square = np.linalg.lstsq(np.column_stack([x, x**2]), force_N, rcond=None)[0]
    assert square / slope == pytest.approx(wanted, rel=0.01)
    assert curvature(amount_for_curvature(wanted, shape), shape) == pytest.approx(wanted, rel=1e-6)
    assert bend(np.array([0.0, 1e-6]), 0.1, shape) == pytest.approx([0.0, 1e-6])


def test_a_gap_takes_its_force_away_and_leaves_nothing_below():
    voltage_V = np.linspace(0.0, 100.0, 2001)
    force_N = answer(voltage_V, **effect("contact_gap", {"softness_N": 0.2}, gap_N=30.0))
    assert force_N[-200:] == pytest.approx(N_PER_V * voltage_V[-200:] - 30.0, abs=0.01)
    assert np.abs(force_N[voltage_V < 14.0]).max() < 0.01


@pytest.mark.parametrize("break_away", [0.1, 0.6])
def test_friction_is_63_percent_after_its_travel_and_twice_its_force_wide(break_away):
    x = np.linspace(0.0, 100.0, 20_001)
    z = friction_force(x, 5.0, 8.0, break_away)
    assert np.interp(8.0, x, z) == pytest.approx(5.0 * (1.0 - np.exp(-1.0)), rel=2e-3)
    voltage_V = triangles(1.0, 3)
    on = effect("friction", {"break_away": break_away}, force_N=5.0, presliding_N=8.0)
    assert opening_percent(voltage_V, answer(voltage_V, **on), 1.0, FULL_N) == pytest.approx(
        100 * 10.0 / FULL_N, rel=1e-3
    )


def test_a_mode_rings_at_its_frequency_and_dies_with_its_damping():
    voltage_V = np.concatenate([hold(0.0, 0.1), hold(50.0, 4.0)])
    force_N = answer(voltage_V, **effect("resonance", frequency_Hz=37.0, damping_ratio=0.02))[101:] - 100.0
    assert line_Hz(force_N * np.exp(2 * np.pi * 37.0 * 0.02 * np.arange(force_N.size) / RATE_HZ)[::1]) == pytest.approx(
        37.0, rel=2e-3
    )
    peaks = np.flatnonzero((force_N[1:-1] > force_N[:-2]) & (force_N[1:-1] > force_N[2:])) + 1
    decrement = np.log(force_N[peaks[1]] / force_N[peaks[11]]) / 10
    assert decrement / (2 * np.pi) == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize(("order", "damping"), [(1, 0.7071), (2, 0.7071), (2, 0.866)])
def test_a_low_pass_is_down_by_three_decibels_at_its_cutoff(order, damping):
    time_s = np.arange(8000) / RATE_HZ
    voltage_V = 50.0 + 40.0 * np.sin(2 * np.pi * 20.0 * time_s)
    on = effect("sensor_filter", {"order": order, "damping_ratio": damping}, cutoff_Hz=20.0)
    assert np.ptp(answer(voltage_V, **on)[4000:]) / np.ptp(answer(voltage_V)[4000:]) == pytest.approx(
        0.5**0.5, rel=2e-3
    )


def test_a_leaking_cell_decays_in_a_hold_and_leans_on_triangles():
    on = effect("charge_leakage", time_constant_s=20.0)
    held = answer(np.concatenate([hold(0.0, 0.1), hold(80.0, 30.0)]), **on)
    assert held[20_100] / held[100] == pytest.approx(np.exp(-1.0), rel=1e-2)
    voltage_V = triangles(0.2, 20)
    opening = opening_percent(voltage_V, answer(voltage_V, **on), 0.2, FULL_N)
    assert -opening == pytest.approx(12.5 / (0.2 * 20.0), rel=0.05)


def test_feedthrough_adds_its_coefficient_times_the_rate():
    voltage_V = triangles(0.5, 2)
    force_N = answer(voltage_V, **effect("feedthrough", {"window_s": 5e-4}, coefficient_N_s_per_V=0.02))
    added = force_N - N_PER_V * voltage_V
    assert added[100:900] == pytest.approx(0.02 * 100.0, abs=1e-6)
    assert added[1100:1900] == pytest.approx(-0.02 * 100.0, abs=1e-6)


def test_hum_and_vibration_have_their_frequency_and_amplitude():
    quiet = hold(0.0, 20.0)
    hum = answer(quiet, **effect("mains_hum", {"harmonics": {"3": 0.3}, "stray_rad": 0.05, "stray_s": 10.0},
                                 amplitude_N=0.7, frequency_Hz=50.02))  # fmt: skip
    assert line_Hz(hum) == pytest.approx(50.02, abs=0.02)
    assert amplitude_at(hum, 50.02) == pytest.approx(0.7, rel=0.01)
    assert amplitude_at(hum, 150.06) == pytest.approx(0.21, rel=0.05)
    shaken = answer(
        quiet, **effect("vibration", {"breathing": 0.1, "breath_s": 8.0}, amplitude_N=2.0, frequency_Hz=23.7)
    )
    assert line_Hz(shaken) == pytest.approx(23.7, abs=0.02)
    assert np.std(shaken) == pytest.approx(2.0 / 2**0.5, rel=0.15)


def test_force_follows_the_temperature_by_its_coefficient():
    temperature_C = 20.0 + 3.0 * np.sin(np.arange(8000) / 2000.0)
    record = drive(hold(50.0, 8.0), temperature_C=temperature_C)
    force_N = forces(straight_plant(), record, **effect("thermal_drift", {"lag_s": 0.0}, coefficient_N_per_K=1.7))
    assert np.polyfit(temperature_C, force_N, 1)[0] == pytest.approx(1.7, rel=1e-6)


def test_a_load_comes_and_goes_at_its_times():
    on = effect("load_step", {"rise_s": 0.01}, step_N=-4.0, on_s=1.0, off_s=2.0)
    added = answer(hold(0.0, 3.0), **on)
    assert added[[990, 1010, 1990, 2011]] == pytest.approx([0.0, -4.0, -4.0, 0.0])


def test_quantised_readings_lie_on_the_lattice_and_frozen_ones_do_not_move():
    values = np.random.default_rng(1).normal(0.0, 5.0, 4000)
    steps = quantised(values, 0.7) / 0.7
    assert steps == pytest.approx(np.round(steps), abs=1e-9)
    assert np.abs(0.7 * steps - values).max() <= 0.35 + 1e-9
    time_s = np.arange(4000) / RATE_HZ
    stuck = frozen(values, time_s, [(1.0, 1.5), (3.0, 3.2)])
    assert (stuck[1000:1500] == values[999]).all()
    assert (stuck[3000:3200] == values[2999]).all()
    assert np.count_nonzero(stuck != values) == 700
