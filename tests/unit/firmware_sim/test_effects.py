"""Each effect, switched on alone, changes the force in the way that its signature says."""

import numpy as np
import pytest

from firmware_sim.physics.effects import Effects
from tests.unit.firmware_sim.waves import bench, forces, hold, opening_percent, triangles

STEP_V = np.concatenate([hold(0.0, 0.1), hold(100.0, 0.9)])  # at sample 100, thus 0.1 s


def slope(force_N, dt_s=1e-3):
    return np.diff(force_N) / dt_s


def lag_on_a_ramp_s(**effects):
    """How much later a force is reached while the voltage rises steadily, once transients have died."""
    drive_V = np.linspace(0.0, 140.0, 4001)
    plain, late = forces(drive_V, interpolate=True), forces(drive_V, interpolate=True, **effects)
    time_s = np.arange(drive_V.size) * 1e-3
    return np.mean((time_s - np.interp(late, plain, time_s))[2000:3800])


def test_all_effects_of_the_catalogue_are_there():
    assert len(Effects.model_fields) == 22


def test_every_effect_that_is_on_changes_some_reading():
    drive_V = np.concatenate([STEP_V, triangles([140.0, 30.0, 140.0], period_s=4.0), hold(60.0, 2.0)])
    plain = forces(drive_V, noise_N=0.1)
    for name in Effects.model_fields:
        difference = np.max(np.abs(forces(drive_V, noise_N=0.1, **{name: {}}) - plain))
        assert difference > 0.1, name


def test_electrical_lag_rounds_a_step_with_its_time_constant():
    device = bench(effects={"electrical_lag": {"time_constant_s": 0.02}})
    device.set_voltage(100.0)
    device.advance(0.02)
    assert device.output_V == pytest.approx(100.0 * (1.0 - np.exp(-1.0)), rel=1e-4)


def test_slew_limit_makes_a_ramp_of_a_step():
    device = bench(effects={"slew_limit": {"limit_V_per_s": 200.0}})
    device.set_voltage(100.0)
    device.advance(0.25)
    assert device.output_V == pytest.approx(50.0, abs=0.05)


def test_voltage_clamp_flattens_the_tops_and_says_so():
    drive_V = triangles([140.0])
    device = bench(effects={"voltage_clamp": {"limit_V": 110.0}})
    force_N = device.run(drive_V, 1e-3)
    beyond = np.flatnonzero(drive_V > 110.5)[1:]
    assert np.ptp(force_N[beyond]) == 0.0
    device.set_voltage(120.0)
    device.advance(0.01)
    assert device.sample().status & 4


@pytest.mark.parametrize("on", [False, True])
def test_rate_dependent_hysteresis_widens_fast_loops_and_rests_at_dwell(on):
    effects = {"rate_dependent_hysteresis": {"growth": 0.05}} if on else {}
    openings = []
    for period_s in (20.0, 0.5):
        drive_V = triangles([140.0] * 2, period_s)
        force_N = forces(drive_V, interpolate=True, **effects)
        openings.append(opening_percent(drive_V[drive_V.size // 2 :], force_N[drive_V.size // 2 :]))
    assert (openings[1] - openings[0] > 1.0) == on
    rest = forces(np.concatenate([triangles([140.0], 0.5)[:100], hold(56.0, 1.0)]), **effects)[-990:]
    assert np.ptp(rest) == 0.0


def test_noncongruent_minor_loops_are_wider_at_low_bias():
    def widths(**effects):
        ramp = 15.0 * (1.0 - np.abs(1.0 - 2.0 * np.arange(1000) / 1000))
        found = []
        for bias_V in (10.0, 110.0):
            drive_V = np.concatenate([triangles([140.0], 2.0), np.linspace(0, bias_V, 500), bias_V + np.tile(ramp, 2)])
            loop = forces(drive_V, **effects)[-1000:]
            # against the loop's own chord, so that the force law's slope drops out
            found.append((loop[750] - loop[250]) / np.ptp(loop))
        return found[0] / found[1]

    assert widths(noncongruent_minor_loops={"share": 0.6}) > 1.2 * widths()


def test_creep_goes_with_the_logarithm_of_time():
    force_N = forces(np.concatenate([hold(100.0, 120.0)]), creep={"per_decade": 0.02, "from_s": 0.01, "to_s": 1000.0})
    at = [1_000, 10_000, 100_000]
    rise = np.diff(force_N[at])
    assert rise[0] > 2.0
    assert rise[1] == pytest.approx(rise[0], rel=0.1)
    immediate = force_N[1]
    assert rise[0] / immediate == pytest.approx(0.02, rel=0.15)


def test_gain_drift_scales_the_whole_range_over_the_record():
    drive_V = triangles([140.0] * 6)
    ratio = forces(drive_V, gain_drift={"relative_change": -0.05, "over_s": 60.0}) / np.maximum(forces(drive_V), 1e-9)
    assert ratio[55_000] == pytest.approx(0.955, abs=0.01)
    assert ratio[5_000] > ratio[25_000] > ratio[55_000]


@pytest.mark.parametrize("curvature", [-0.1, 0.1])
def test_output_nonlinearity_depends_on_the_force_alone(curvature):
    drive_V = triangles([140.0] * 2)
    plain, bent = forces(drive_V), forces(drive_V, output_nonlinearity={"curvature": curvature})
    order = np.argsort(plain)
    assert np.all(np.diff(bent[order]) >= -1e-9)
    at_full = bent.max() / plain.max() - 1.0
    assert at_full == pytest.approx(np.expm1(2 * curvature) / (2 * curvature) - 1.0, rel=1e-3)


def test_contact_gap_holds_the_force_at_zero_until_contact():
    drive_V = triangles([140.0])
    plain, gapped = forces(drive_V), forces(drive_V, contact_gap={"gap_N": 30.0})
    assert np.all(gapped[plain < 30.0] == 0.0)
    assert gapped[5000] == pytest.approx(plain[5000] - 30.0, abs=1.0)


def test_friction_takes_its_force_both_ways():
    drive_V = triangles([140.0] * 2)
    loss = forces(drive_V) - forces(drive_V, friction={"force_N": 3.0, "presliding_N": 10.0})
    assert loss[13_000] == pytest.approx(3.0, abs=0.01)
    assert loss[17_000] == pytest.approx(-3.0, abs=0.01)


def test_resonance_rings_at_its_frequency_and_dies_by_its_damping():
    force_N = forces(STEP_V, resonance={"frequency_Hz": 40.0, "damping_ratio": 0.02})[101:]
    ringing = force_N - force_N[-50:].mean()
    crossings = np.flatnonzero(np.diff(np.sign(ringing[:500])) != 0)
    assert 0.5e3 / np.mean(np.diff(crossings)) == pytest.approx(40.0, rel=0.02)
    envelope = [np.max(np.abs(ringing[start : start + 25])) for start in (0, 250)]
    assert np.log(envelope[0] / envelope[1]) == pytest.approx(0.02 * 2 * np.pi * 40.0 * 0.25, rel=0.1)


def test_resonance_trails_a_ramp_by_twice_the_damping_over_the_frequency():
    expected_s = 2 * 0.7 / (2 * np.pi * 30.0)
    measured_s = lag_on_a_ramp_s(resonance={"frequency_Hz": 30.0, "damping_ratio": 0.7})
    assert measured_s == pytest.approx(expected_s, rel=3e-3)


@pytest.mark.parametrize(
    ("effect", "expected_s"),
    [
        ({"electrical_lag": {"time_constant_s": 0.01}}, 0.01),
        ({"sensor_filter": {"cutoff_Hz": 10.0}}, 0.5 / np.pi / 10.0),
        ({"sensor_filter": {"cutoff_Hz": 10.0, "order": 2}}, np.sqrt(2.0) * 0.5 / np.pi / 10.0),
    ],
)
def test_lags_trail_a_ramp_by_their_time_constant(effect, expected_s):
    assert lag_on_a_ramp_s(**effect) == pytest.approx(expected_s, rel=1e-2)


def test_thermal_drift_follows_the_temperature_channel():
    device = bench(effects={"thermal_drift": {"coefficient_N_per_K": 3.0}})
    temperature, force_N = [], []
    for _ in range(100):
        device.advance(0.5)
        temperature.append(device.sample().temperature_C)
        force_N.append(device.sample().force_N)
    assert np.ptp(temperature) > 0.5
    assert np.polyfit(temperature, force_N, 1)[0] == pytest.approx(3.0, rel=0.02)


def test_load_step_comes_and_goes_at_its_instants():
    force_N = forces(np.zeros(3000), load_step={"step_N": 6.0, "on_s": 1.0, "off_s": 2.0})
    assert force_N[999] == 0.0
    assert force_N[1100] == pytest.approx(6.0, abs=1e-6)
    assert force_N[2100] == pytest.approx(0.0, abs=1e-6)


def test_load_step_without_an_end_stays():
    force_N = forces(np.zeros(3000), load_step={"step_N": 6.0, "on_s": 1.0, "off_s": None})
    assert force_N[-1] == pytest.approx(6.0, abs=1e-6)


def test_vibration_is_a_line_at_its_frequency():
    spectrum = np.abs(np.fft.rfft(forces(np.zeros(20_000), vibration={"amplitude_N": 2.0, "frequency_Hz": 23.0})))
    assert np.argmax(spectrum) / 20.0 == pytest.approx(23.0, abs=0.051)
    assert 2.0 * spectrum.max() / 20_000 == pytest.approx(2.0, rel=0.15)


def test_charge_leakage_forgets_a_held_force():
    force_N = forces(np.concatenate([STEP_V, hold(100.0, 5.0)]), charge_leakage={"time_constant_s": 2.0})
    assert force_N[2_101] / force_N[101] == pytest.approx(np.exp(-1.0), rel=1e-3)


@pytest.mark.parametrize("order", [1, 2])
def test_sensor_filter_is_down_three_decibels_at_its_cutoff(order):
    time_s = np.arange(4000) * 1e-3
    drive_V = 70.0 + 0.05 * np.sin(2 * np.pi * 20.0 * time_s)
    plain = forces(drive_V, interpolate=True)
    filtered = forces(drive_V, interpolate=True, sensor_filter={"cutoff_Hz": 20.0, "order": order})
    assert np.ptp(filtered[2000:]) / np.ptp(plain[2000:]) == pytest.approx(np.sqrt(0.5), rel=0.02)


def test_sensor_filter_leaves_the_true_force_alone():
    device = bench(effects={"sensor_filter": {"cutoff_Hz": 2.0}})
    plain = bench()
    for each in (device, plain):
        each.set_voltage(100.0)
        each.advance(0.01)
    assert device.true_force_N == plain.true_force_N
    assert device.sample().force_N < 0.5 * plain.sample().force_N


def test_feedthrough_jumps_with_the_sign_of_the_rate():
    drive_V = triangles([140.0])
    extra = forces(drive_V, interpolate=True, feedthrough={"coefficient_N_s_per_V": 0.1}) - forces(
        drive_V, interpolate=True
    )
    assert extra[2500] == pytest.approx(2.8, abs=0.02)  # 0.1 N s/V times 28 V/s
    assert extra[7500] == pytest.approx(-2.8, abs=0.02)


def test_mains_hum_is_a_line_with_odd_harmonics():
    spectrum = np.abs(np.fft.rfft(forces(np.zeros(20_000), mains_hum={"amplitude_N": 1.0, "frequency_Hz": 50.0})))
    strongest = np.argsort(spectrum)[-1]
    assert strongest == 1000
    assert spectrum[3000] / spectrum[1000] == pytest.approx(0.3, rel=0.1)


def test_sensor_dropout_freezes_the_reading_and_not_the_heartbeat():
    places = {"places_s": [[0.5, 0.8]]}
    force_N = forces(triangles([140.0], 1.0), noise_N=0.1, sensor_dropout=places)
    assert np.ptp(force_N[501:800]) == 0.0
    assert np.ptp(force_N[801:820]) > 0.0
    device = bench(effects={"sensor_dropout": places})
    device.advance(0.6)
    before = device.sample().heartbeat
    device.advance(0.1)
    assert device.sample().heartbeat == before + 400


def test_quantisation_puts_readings_on_a_lattice():
    force_N = forces(triangles([140.0], 1.0), noise_N=0.1, quantisation={"step_N": 0.7})
    np.testing.assert_allclose(force_N / 0.7, np.rint(force_N / 0.7), atol=1e-9)


@pytest.mark.parametrize("delay_s", [0.005, 0.00503, 0.01237])
def test_transport_delay_shifts_by_its_time_and_no_part_of_a_step_more(delay_s):
    assert lag_on_a_ramp_s(transport_delay={"delay_s": delay_s}) == pytest.approx(delay_s, abs=2e-6)


def test_transport_delay_leaves_an_edge_sharp():
    late = forces(STEP_V, transport_delay={"delay_s": 0.03})
    assert np.array_equal(np.unique(late[:131]), [0.0])
    assert late[131] == forces(STEP_V)[101]


@pytest.mark.parametrize("skew_ppm", [-2000.0, 2000.0])
def test_clock_skew_shifts_ever_more(skew_ppm):
    drive_V = triangles([140.0] * 4)
    plain = forces(drive_V, interpolate=True)
    skewed = forces(drive_V, interpolate=True, clock_skew={"skew_ppm": skew_ppm})
    time_s = np.arange(drive_V.size) * 1e-3
    expected = np.interp(time_s * (1.0 + 1e-6 * skew_ppm), time_s, plain)
    inside = slice(100, 39_000)
    assert np.max(np.abs(skewed - expected)[inside]) < 0.03
