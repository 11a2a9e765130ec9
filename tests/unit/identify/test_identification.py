"""Identification: known models come back, noise is averaged, and what tells nothing is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.errors import RecordingError
from piezod.estimation.base.thresholds import Reach, dead_zone_thresholds, play_reach, play_thresholds
from piezod.estimation.fit.columns import Samples, Structure, zone_segments, zone_slopes_of, zone_weights_of
from piezod.estimation.fit.normal_equations import pieces_of, sums_of
from piezod.estimation.fit.quadratic_program import Constraints
from piezod.excitation import constant_triangles, varying_triangles
from piezod.identify.fit import fit_hysteresis
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.identify.simulation import simulate, simulate_recording
from piezod.identify.tables import dead_zone_rows, play_rows
from piezod.model import load_model
from piezod.operators import PrandtlIshlinskii
from piezod.operators.dead_zone import inverse_dead_zone
from piezod.recording import Recording, read_csv
from tests.unit.operators.analytic_inverse import AnalyticInverse

FLEXURE = Path(__file__).parents[4] / "shared" / "recordings" / "piezo-flexure"
U_MAX, Y_MAX = 140.0, 300.0


def excitation(two_sided):
    rise = varying_triangles(U_MAX, 0.1, 61, 50.0)
    if not two_sided:
        return rise
    time = np.arange(20_000) / 50.0
    return np.concatenate((rise, -rise, U_MAX * np.sin(0.6 * time) * np.linspace(1.0, 0.0, time.size)))


def known_operator(plays, zones, two_sided, seed):
    rng = np.random.default_rng(seed)
    thresholds = play_thresholds(plays, 139.0 if two_sided else 70.0)
    weights = np.concatenate(([0.5], rng.uniform(-0.01, 0.1, plays)))
    weights /= np.sum(weights * (1.0 - thresholds / U_MAX))
    zone_thresholds = dead_zone_thresholds(zones, -Y_MAX if two_sided else 0.0, Y_MAX)
    inverse_weights = zone_weights_of(zone_thresholds, 0.45 + rng.uniform(-0.2, 0.2, zone_thresholds.size))
    direct = inverse_dead_zone(zone_thresholds, inverse_weights)
    structure = Structure(thresholds, zone_thresholds, 0.0, U_MAX, U_MAX / Y_MAX)
    return PrandtlIshlinskii(thresholds, weights, *direct), structure


def all_samples(u, y):
    return [Samples(u, y, np.ones(u.size, bool))]


@pytest.mark.parametrize(
    ("plays", "zones", "two_sided"),
    [(3, 0, False), (7, 3, False), (20, 4, False), (30, 8, False), (12, 3, True), (30, 8, True)],
)
def test_a_known_model_comes_back_from_noise_free_data_to_1e_8(plays, zones, two_sided):
    operator, structure = known_operator(plays, zones, two_sided, seed=plays)
    u = excitation(two_sided)
    fit = fit_hysteresis(structure, all_samples(u, operator.run(u)), variant="B")
    np.testing.assert_allclose(fit.hysteresis.plays.weights, operator.plays[1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(fit.hysteresis.dead_zones.weights, operator.dead_zones[1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(fit.hysteresis.dead_zones.thresholds, operator.dead_zones[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("plays", "zones", "two_sided"), [(7, 3, False), (20, 4, False), (30, 8, False), (12, 3, True)]
)
def test_a_tenth_of_a_percent_of_noise_costs_less_than_a_twentieth_of_itself_on_held_out_data(plays, zones, two_sided):
    operator, structure = known_operator(plays, zones, two_sided, seed=plays)
    u = excitation(two_sided)
    y = operator.run(u)
    noise = 1e-3 * np.ptp(y)
    rng = np.random.default_rng(11)
    fit = fit_hysteresis(structure, all_samples(u, y + rng.normal(0.0, noise, y.size)))
    held_out_u = np.concatenate(([0.0], constant_triangles(110.0, 0.1, 3, 50.0)))
    truth = PrandtlIshlinskii(*operator.plays, *operator.dead_zones).run(held_out_u)
    measured = truth + rng.normal(0.0, noise, truth.size)
    error = measured - fit.hysteresis.operator().run(held_out_u)
    assert np.sqrt(np.mean(error**2)) <= 1.05 * noise


@pytest.mark.parametrize(("plays", "zones"), [(7, 3), (20, 4), (30, 8)])
def test_variant_a_finds_a_known_model_without_negative_weights_to_1e_8(plays, zones):
    operator, structure = known_operator(plays, zones, two_sided=False, seed=plays)
    weights = np.abs(operator.plays[1])
    weights /= np.sum(weights * (1.0 - operator.plays[0] / U_MAX))
    operator = PrandtlIshlinskii(operator.plays[0], weights, *operator.dead_zones)
    u = excitation(two_sided=False)
    fit = fit_hysteresis(structure, all_samples(u, operator.run(u)), variant="A")
    np.testing.assert_allclose(fit.hysteresis.plays.weights, weights, rtol=0, atol=1e-8)
    np.testing.assert_allclose(fit.hysteresis.dead_zones.weights, operator.dead_zones[1], rtol=0, atol=1e-8)


def test_variant_a_gives_no_negative_weight_where_variant_b_finds_the_true_one():
    operator, structure = known_operator(7, 0, False, seed=3)
    weights = operator.plays[1].copy()
    weights[2] = -0.08
    weights /= np.sum(weights * (1.0 - operator.plays[0] / U_MAX))
    operator = PrandtlIshlinskii(operator.plays[0], weights, *operator.dead_zones)
    u = excitation(False)
    samples = all_samples(u, operator.run(u))
    assert min(fit_hysteresis(structure, samples, variant="A").hysteresis.plays.weights) >= -1e-12
    assert fit_hysteresis(structure, samples, variant="B").hysteresis.plays.weights[2] == pytest.approx(
        weights[2], abs=1e-8
    )


def test_every_partial_sum_stays_above_eps_where_the_data_would_fold():
    operator, structure = known_operator(7, 0, False, seed=3)
    u = excitation(False)
    y = operator.run(u) - 1.5 * np.clip(u - 60.0, 0.0, 20.0)  # a stretch where the output stands still or falls
    fit = fit_hysteresis(structure, all_samples(u, y), eps=0.05)
    assert np.cumsum(fit.hysteresis.plays.weights).min() >= 0.05 - 1e-9


def test_the_normalisation_holds():
    operator, structure = known_operator(20, 4, False, seed=5)
    u = excitation(False)
    fit = fit_hysteresis(structure, all_samples(u, operator.run(u)))
    weights, thresholds = np.array(fit.hysteresis.plays.weights), np.array(fit.hysteresis.plays.thresholds)
    assert np.sum(weights * (U_MAX - thresholds)) == pytest.approx(U_MAX, rel=1e-10)
    assert Constraints.of(structure, 1, variant="B", eps=0.01).rows.shape == (21 + 5, structure.columns + 1)


def test_a_drift_of_the_sensor_does_not_bend_the_loop():
    operator, structure = known_operator(7, 3, False, seed=2)
    u = excitation(False)
    y = operator.run(u)
    clock = np.linspace(-1.0, 0.0, u.size)
    counts = np.ones(u.size, bool)
    errors = []
    for known_clock in (None, clock):
        fit = fit_hysteresis(structure, [Samples(u, y + 5.0 * clock, counts, known_clock)])
        errors.append(np.sqrt(np.mean((fit.hysteresis.operator().run(u) - y) ** 2)))
    assert errors[1] < errors[0] / 10


@given(st.lists(st.floats(-3, 3), min_size=1, max_size=9), st.integers(0, 4))
def test_dead_zone_slopes_and_weights_are_each_others_inverse(weights, below):
    weights = np.array(weights)
    thresholds = np.arange(weights.size, dtype=float) - min(below, weights.size - 1)
    again = zone_weights_of(thresholds, zone_slopes_of(thresholds, weights))
    np.testing.assert_allclose(again, weights, atol=1e-12)


@given(st.lists(st.floats(-9, 9), min_size=1, max_size=30), st.integers(0, 3), st.integers(0, 3))
def test_the_segments_of_a_value_add_up_to_it(values, above, below):
    thresholds = np.arange(-below, above + 1, dtype=float)
    x = np.array(values)
    np.testing.assert_allclose(zone_segments(thresholds, x).sum(axis=1), x, atol=1e-12)


def test_the_tables_of_the_inverse_are_those_that_invert():
    operator, structure = known_operator(7, 3, False, seed=4)
    u = excitation(False)
    hysteresis = fit_hysteresis(structure, all_samples(u, operator.run(u))).hysteresis
    inverse = AnalyticInverse(hysteresis.operator())
    count = len(hysteresis.plays.weights)
    np.testing.assert_allclose([one.inverse_threshold for one in play_rows(hysteresis)], inverse.packed[3 : 3 + count])
    np.testing.assert_allclose(
        [one.inverse_weight for one in play_rows(hysteresis)], inverse.packed[3 + count : 3 + 2 * count]
    )
    assert [one.index for one in dead_zone_rows(hysteresis)] == [0, 1, 2, 3]


def recording_of(u, y, source="rec.csv"):
    return Recording(np.arange(u.size) / 50.0, {"voltage_V": u, "force_N": y}, source=source)


def test_the_smallest_orders_that_will_do_on_data_held_out_are_taken():
    u = varying_triangles(U_MAX, 0.1, 41, 50.0)
    operator = PrandtlIshlinskii(play_thresholds(6, 0.995 * U_MAX), [0.5, *[0.1] * 6], [0.0], [2.0])
    y = operator.run(u) + np.random.default_rng(1).normal(0.0, 0.3, u.size)
    found = identify([recording_of(u, y)], Options(orders=True), "a test")
    assert (found.chosen.plays, found.chosen.zones) == (6, 0)
    assert found.chosen.rms_held_out == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("begin", ["from rest", "amid the range", "sine amid the range"])
def test_every_start_is_identified_to_the_noise_and_every_sample_is_held_out_once(begin):
    thresholds = play_thresholds(30, 0.995 * U_MAX)
    operator = PrandtlIshlinskii(thresholds, np.append(0.7, 0.05 * np.exp(-thresholds[1:] / 40.0)), [0.0], [2.0])
    u = varying_triangles(U_MAX, 0.1, 15, 50.0)
    if begin != "from rest":
        operator.run(np.array([U_MAX, 30.0]))
        size = 0.0 if begin.startswith("sine") else 1.0
        time = np.arange(8000) / 50.0
        u = 70.0 - 40.0 * np.cos(0.6 * time) * (1.0 - 0.9 * size * np.exp(-0.02 * time))
        u = np.concatenate((np.linspace(30.0, u[0], 50), u))
    y = operator.run(u)
    noise = 1e-3 * np.ptp(y)
    found = identify([recording_of(u, y + np.random.default_rng(5).normal(0.0, noise, u.size))], Options(), "a test")
    assert found.chosen.rms_held_out == pytest.approx(noise, rel=0.05)
    assert found.chosen.rms_fit <= found.chosen.rms_held_out


@pytest.mark.parametrize("options", [Options(), Options(plays=6, zones=0), Options(plays=6)])
def test_the_verdict_names_the_noise_of_repeats_however_the_orders_came(options):
    u = constant_triangles(U_MAX, 0.5, 12, 250.0)
    operator, _ = known_operator(6, 0, False, seed=9)
    y = operator.run(u) + np.random.default_rng(1).normal(0.0, 0.1, u.size)
    found = identify([recording_of(u, y)], options, "a test")
    assert found.noise is not None
    assert found.noise.rms == pytest.approx(0.1, rel=0.1)
    assert "seen in repeats" in found.verdict


def test_the_constraints_of_the_thesis_are_kept_where_they_are_asked_for():
    u = varying_triangles(U_MAX, 0.1, 15, 50.0)
    operator, _ = known_operator(6, 0, False, seed=9)  # some of its weights are negative
    y = operator.run(u) + np.random.default_rng(1).normal(0.0, 0.1, u.size)
    model = identify([recording_of(u, y)], Options(variant="A", eps=1e-3), "a test").model
    assert min(model.hysteresis.plays.weights) >= -1e-9


TRIANGLES = varying_triangles(U_MAX, 0.1, 7, 50.0)


def test_what_a_first_rise_before_the_recording_moved_is_found_and_kept():
    thresholds = play_thresholds(30, 0.995 * U_MAX)
    operator = PrandtlIshlinskii(thresholds, np.append(0.7, 0.05 * np.exp(-thresholds[1:] / 40.0)), [0.0], [2.0])
    rise, sine = np.linspace(0.0, 0.5 * U_MAX, 50), 0.5 * U_MAX * (1.0 + np.sin(np.arange(4000) * 0.0126))
    y = operator.run(np.concatenate((rise, sine)))[rise.size :]
    found = identify([recording_of(sine, y + np.random.default_rng(1).normal(0.0, 0.1, y.size))], Options(), "a test")
    assert found.chosen.rms_fit < 0.105
    assert not any("not used" in note for note in found.notes)
    again = found.model.operator().run(np.concatenate((rise, sine)))[rise.size :]
    assert np.sqrt(np.mean((again - y) ** 2)) < 0.05


def test_an_output_that_falls_is_modelled_by_its_negative():
    operator, _ = known_operator(6, 2, False, seed=9)
    y = operator.run(TRIANGLES)
    rising, falling = (identify([recording_of(TRIANGLES, sign * y)], Options(), "a test") for sign in (1.0, -1.0))
    assert falling.model.output.channel == "-force_N"
    np.testing.assert_allclose(falling.model.hysteresis.plays.weights, rising.model.hysteresis.plays.weights, atol=1e-9)
    assert "rec.csv: force_N falls where voltage_V rises" in falling.notes[0]


def test_missing_forces_are_left_out_and_do_not_change_the_model():
    operator, _ = known_operator(6, 2, False, seed=9)
    u = varying_triangles(U_MAX, 0.1, 41, 50.0)
    y = operator.run(u)
    y[1000:1400] = np.nan
    model = identify([recording_of(u, y)], Options(plays=14, zones=4), "a test").model
    error = model.operator().run(u) - operator_again(operator, u)
    assert np.sqrt(np.mean(error**2)) < 0.003 * np.ptp(operator_again(operator, u))


def operator_again(operator, u):
    return PrandtlIshlinskii(*operator.plays, *operator.dead_zones).run(u)


@pytest.mark.parametrize(
    ("u", "y", "says"),
    [
        (TRIANGLES[:50], TRIANGLES[:50], "has 50 samples, needs at least 100"),
        (TRIANGLES, np.full(TRIANGLES.size, 7.5), "force_N is constant at 7.5"),
        (np.zeros(TRIANGLES.size), TRIANGLES, "voltage_V is constant at 0"),
        (TRIANGLES, np.full(TRIANGLES.size, np.nan), "force_N holds no number at all"),
        (np.where(TRIANGLES > 100, np.nan, TRIANGLES), TRIANGLES, "voltage_V has"),
    ],
)
def test_a_recording_that_tells_nothing_is_refused_with_what_to_record_instead(u, y, says):
    with pytest.raises(RecordingError, match=says) as caught:
        identify([recording_of(u, y)], Options(), "a test")
    assert str(caught.value).startswith("rec.csv: ")
    assert "\n" not in str(caught.value)


def test_a_record_that_does_not_start_at_rest_is_simulated_from_a_start_found_in_its_first_stretch():
    operator, _ = known_operator(7, 3, False, seed=4)
    whole = np.concatenate((constant_triangles(U_MAX, 0.1, 2, 50.0), varying_triangles(90.0, 0.1, 5, 50.0)))
    y = operator.run(whole)
    model = identify([recording_of(whole, y)], Options(plays=14, zones=4), "a test").model
    part = slice(700, None)
    simulated, words = simulate(model, recording_of(whole[part], y[part]), 100)
    assert "found from the first 100 samples" in words
    assert np.sqrt(np.mean((simulated - y[part])[100:] ** 2)) < 0.01 * np.ptp(y)


def test_a_record_after_other_work_is_simulated_from_the_peak_that_its_first_stretch_tells():
    model = load_model(Path(__file__).parents[3] / "config" / "model.yaml")
    later = varying_triangles(0.5 * model.input.high, 0.1, 2, 50.0)
    fresh, used = model.operator(), model.operator()
    used.run(np.array([model.input.high, 0.0]))
    y = used.run(later)
    simulated, words = simulate(model, recording_of(later, y), 50)
    assert words == f"driven to about {model.input.high:.3g} V and back before, found from the first 50 samples"
    assert np.abs(simulated - y).max() < 1e-9 * np.ptp(y)
    assert np.abs(simulate(model, recording_of(later, y), 0)[0] - y).max() > 0.05 * np.ptp(y)  # nothing looked at
    assert simulate(model, recording_of(later, fresh.run(later)), 50)[1] == "start of the model (virgin)"
    fresh = model.operator()
    tared = fresh.run(later) + 0.1 * np.ptp(y)
    assert simulate(model, recording_of(later, tared), 50)[1] == "start of the model (virgin)"  # no peak is a tare


def test_only_a_virgin_rise_shows_the_plays_beyond_half_the_swing():
    whole, half = 0.995 * U_MAX, 0.995 * 0.5 * U_MAX
    assert play_reach(TRIANGLES, (), at_rest=True) == Reach(pytest.approx(whole))
    assert play_reach(TRIANGLES, (U_MAX, 0.0), at_rest=True) == Reach(pytest.approx(half))
    assert play_reach(TRIANGLES + 20.0, (20.0,), at_rest=False) == Reach(pytest.approx(half))
    assert play_reach(TRIANGLES, (0.3 * U_MAX, 0.0), at_rest=True) == Reach(pytest.approx(whole))


def test_a_rise_past_an_old_peak_gets_one_threshold_between_half_the_swing_and_that_peak():
    assert play_reach(TRIANGLES, (100.0, 0.0), at_rest=True).beyond == pytest.approx(85.0)


@pytest.mark.parametrize("old_peak", [None, 45.0, 100.0, 140.0])
def test_what_a_stack_was_driven_to_before_is_found_in_its_first_rise(old_peak):
    operator, _ = known_operator(20, 3, False, seed=6)
    operator = PrandtlIshlinskii(
        operator.plays[0] * 1.9, operator.plays[1], *operator.dead_zones
    )  # wide plays as well, so that the first rise differs
    u = varying_triangles(U_MAX, 0.1, 41, 50.0)
    operator.run(np.array([0.0] if old_peak is None else [old_peak, 0.0]))
    y = operator.run(u) + np.random.default_rng(1).normal(0.0, 0.1, u.size)
    y -= y[0]
    found = identify([recording_of(u, y)], Options(plays=23, zones=6), "a test")
    assert found.model.start.kind == ("virgin" if old_peak is None else "reset")
    if old_peak is not None:
        assert found.model.start.peak == pytest.approx(old_peak, abs=5.0)
    assert found.chosen.rms_fit < 0.005 * np.ptp(y)


@pytest.mark.skipif(not FLEXURE.exists(), reason="the recordings in ../shared are not here")
def test_a_real_stack_is_identified_to_less_than_half_a_percent_of_range_on_data_held_out():
    recording = read_csv(FLEXURE / "identification.csv")
    model = identify([recording], Options(output="displacement_um", orders=True), "a test").model
    rms_held_out = model.provenance.fit.rms_held_out
    print("held-out rms", rms_held_out, "um of", model.output.high - model.output.low)
    assert rms_held_out <= 0.0045 * (model.output.high - model.output.low)
    assert model.provenance.recordings[0].samples == recording.time_s.size


@pytest.mark.skipif(not FLEXURE.exists(), reason="the recordings in ../shared are not here")
def test_the_other_file_of_a_real_stack_is_predicted_to_two_percent_of_its_range_and_better_than_by_the_order_table():
    """The first holds one loop again and again, the other smaller ones too: rough slopes fit the first alone."""
    recording, other = (read_csv(FLEXURE / name) for name in ("identification.csv", "tracking.csv"))
    errors = []
    for orders in (False, True):
        model = identify([recording], Options(output="displacement_um", orders=orders), "a test").model
        errors.append(simulate_recording(model, other, 1.0).agreement.rms)
    print("errors of the other file", errors, "um")
    assert errors[0] < 0.02 * np.ptp(other.channel("displacement_um"))
    assert errors[0] < errors[1]


def test_operators_that_hardly_matter_are_pruned_and_the_rest_refitted():
    u = varying_triangles(U_MAX, 0.1, 41, 50.0)
    thresholds = play_thresholds(23, 0.995 * U_MAX)
    weights = np.zeros(24)
    weights[[0, 3, 9, 17]] = [0.5, 0.2, 0.15, 0.15]
    operator = PrandtlIshlinskii(thresholds, weights, [0.0], [2.0])
    y = operator.run(u) + np.random.default_rng(1).normal(0.0, 0.1, u.size)
    recording = recording_of(u, y)
    whole = identify([recording], Options(plays=23, zones=0, prune=False), "a test")
    pruned = identify([recording], Options(plays=23, zones=0), "a test")
    kept = [k for k, r in enumerate(thresholds) if r in pruned.chosen.fit.structure.play_thresholds]
    assert {0, 3, 9, 17} <= set(kept)
    assert len(kept) < 12
    assert pruned.chosen.rms_held_out <= 1.01 * whole.chosen.rms_held_out
    assert (pruned.before_pruning.plays, pruned.chosen.plays) == (23, len(kept) - 1)


def test_the_normal_equations_predict_the_error_of_other_parameters():
    operator, structure = known_operator(7, 3, False, seed=4)
    u = varying_triangles(U_MAX, 0.1, 21, 50.0)
    y = operator.run(u) + np.random.default_rng(3).normal(0.0, 0.5, u.size)
    zones, zone_weights = operator.dead_zones
    at = np.concatenate((np.cumsum(operator.plays[1]), [0.0], zone_slopes_of(zones, zone_weights)))
    sums = sums_of(pieces_of(structure, all_samples(u, y)), structure, zones, at)
    step = np.random.default_rng(5).normal(0.0, 4e-3, at.size)
    slopes, constant, zone_slopes = np.split(at + step, [operator.plays[1].size, operator.plays[1].size + 1])
    plays = PrandtlIshlinskii(structure.play_thresholds, np.diff(slopes, prepend=0.0), [0.0], [1.0])
    modelled = zone_segments(zones, plays.run(u) + constant) @ zone_slopes + structure.origin
    assert sums.samples.sum() == u.size
    assert np.sum((y - modelled) ** 2) == pytest.approx(sums.errors(step).sum(), rel=2e-3)
    assert step @ sums.total[0] @ step > 0.01 * sums.errors(step).sum()
