"""The plays and the modified Prandtl-Ishlinskii operator, against their definitions."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezod.errors import ModelError
from piezod.operators import ImplicitInverse, PrandtlIshlinskii
from piezod.operators.dead_zone import inverse_dead_zone, shifted
from piezod.operators.play import inverse_table

from .analytic_inverse import AnalyticInverse

RANGE_V = 140.0


@st.composite
def superpositions(draw, most=8, first=1.0):
    """Thresholds from 0 and weights, some negative, whose partial sums all stay at least 0.02."""
    count = draw(st.integers(0, most))
    steps = draw(st.lists(st.floats(0.5, 20.0), min_size=count, max_size=count))
    slopes = draw(st.lists(st.floats(0.02, 3.0), min_size=count + 1, max_size=count + 1))
    thresholds = np.concatenate(([0.0], np.cumsum(steps)))
    return thresholds, np.diff(slopes, prepend=0.0) * first


@st.composite
def operators(draw):
    plays = draw(superpositions())
    upper = draw(superpositions(most=4, first=2.0))
    if draw(st.booleans()):
        lower = draw(superpositions(most=4, first=2.0))
        weights = np.concatenate((lower[1][:0:-1], [upper[1][0]], upper[1][1:]))
        lower_slopes = np.cumsum(np.concatenate(([upper[1][0]], lower[1][1:])))
        if lower_slopes.min() < 0.04:  # the centre weight is shared: keep the lower side invertible
            weights = np.concatenate((np.abs(lower[1][:0:-1]), upper[1]))
        zones = np.concatenate((-lower[0][:0:-1], upper[0])), weights
    else:
        zones = upper
    return PrandtlIshlinskii(*plays, *zones, offset=draw(st.floats(-50, 50)), eps=1e-3)


voltages = st.lists(st.floats(0.0, RANGE_V), min_size=1, max_size=60).map(np.array)
nested_reversals = st.lists(st.floats(0.0, 1.0), min_size=2, max_size=20).map(
    lambda shares: np.array(list(itertools.accumulate(shares, lambda u, s: u + ((RANGE_V - u) if u < 70 else -u) * s)))
)


def play_by_definition(r, u, z=0.0):
    states = []
    for value in u:
        z = max(value - r, min(value + r, z))
        states.append(z)
    return np.array(states)


def output_by_definition(operator, u):
    """Equations 3.1 to 3.8, written out element by element."""
    v = sum(w * play_by_definition(r, u) for r, w in zip(*operator.plays, strict=True))
    y = np.zeros_like(v)
    for r, w in zip(*operator.dead_zones, strict=True):
        y += w * (np.maximum(v - r, 0) if r > 0 else np.minimum(v - r, 0) if r < 0 else v)
    return y + operator.offset


@given(operators(), voltages)
def test_the_operator_is_the_sum_of_its_plays_and_dead_zones(operator, u):
    expected = output_by_definition(operator, u)
    np.testing.assert_allclose(operator.run(u), expected, rtol=0, atol=1e-11 * (1 + np.abs(expected).max()))


def test_play_ignores_a_reversal_smaller_than_its_width():
    play = PrandtlIshlinskii([0.0, 5.0], [1e-6, 1.0], eps=1e-7)
    at_peak = play.step(50.0)
    assert play.step(50.0 - 9.99) == pytest.approx(at_peak, abs=1e-4)
    assert play.step(50.0 - 12.0) == pytest.approx(at_peak - 2.0, abs=1e-4)


@given(operators(), st.one_of(voltages, nested_reversals))
def test_both_inverses_after_forward_are_the_identity(operator, u):
    implicit, analytic = ImplicitInverse(operator), AnalyticInverse(operator)
    y = operator.run(u)
    steepness = np.abs(np.cumsum(operator.plays[1])).max() * 1 / np.cumsum(operator.plays[1]).min()
    tolerance = 1e-12 * RANGE_V * max(1.0, steepness) * 10
    np.testing.assert_allclose(implicit.run(y, -1e9, 1e9), u, rtol=0, atol=tolerance)
    np.testing.assert_allclose([analytic.step(value) for value in y], u, rtol=0, atol=tolerance)


def typical_operator(two_sided=False):
    zones = (
        ([-40.0, -15.0, 0.0, 30.0, 80.0], [0.2, -0.3, 2.0, -0.2, 0.3])
        if two_sided
        else ([0.0, 30.0, 80.0], [2.0, -0.2, 0.3])
    )
    return PrandtlIshlinskii([0.0, 2.0, 5.0, 12.0, 30.0], [0.6, 0.2, -0.1, 0.15, 0.2], *zones, offset=3.0)


@pytest.mark.parametrize("two_sided", [False, True])
def test_inverse_after_forward_is_exact_to_1e_12_of_range(two_sided):
    operator = typical_operator(two_sided)
    rng = np.random.default_rng(7)
    u = rng.uniform(-RANGE_V if two_sided else 0.0, RANGE_V, 20_000)
    implicit, analytic = ImplicitInverse(operator), AnalyticInverse(operator)
    y = operator.run(u)
    assert np.abs(implicit.run(y, -1e9, 1e9) - u).max() <= 1e-12 * RANGE_V
    assert np.abs([analytic.step(value) - wanted for value, wanted in zip(y, u, strict=True)]).max() <= 1e-12 * RANGE_V


@given(operators(), voltages, st.floats(0, 60), st.floats(80, RANGE_V), st.floats(0, RANGE_V))
def test_the_implicit_inverse_stays_exact_after_clamping(operator, references_V, low, high, u):
    inverse = ImplicitInverse(operator)
    for voltage in references_V:
        applied = min(max(inverse.plan(operator.run([voltage])[0]), low), high)
        inverse.commit(applied)
        operator.set_states(inverse_states_of(inverse))
    assert inverse.plan(operator.step(u)) == pytest.approx(u, abs=1e-9)


def inverse_states_of(inverse):
    count = int(inverse.packed[0])
    return inverse.packed[3 + 2 * count : 3 + 3 * count]


def test_an_analytic_inverse_that_is_clipped_goes_wrong_where_plan_and_commit_do_not():
    operator = typical_operator()
    implicit, analytic = ImplicitInverse(operator), AnalyticInverse(operator)
    plant, clipped_plant = typical_operator(), typical_operator()
    reference = np.concatenate((np.linspace(0, 600, 50), np.linspace(600, 100, 50), np.linspace(100, 200, 60)))
    planned_error = clipped_error = 0.0
    for wanted in reference:
        u = min(max(implicit.plan(wanted), 0.0), RANGE_V)
        implicit.commit(u)
        reached = plant.step(u)
        clipped = clipped_plant.step(min(max(analytic.step(wanted), 0.0), RANGE_V))
        if 0.0 < u < RANGE_V:
            planned_error = max(planned_error, abs(reached - wanted))
            clipped_error = max(clipped_error, abs(clipped - wanted))
    assert planned_error < 1e-10
    assert clipped_error > 1.0


@given(operators(), voltages, st.floats(0, RANGE_V), st.floats(0, 1), st.floats(0, 1))
def test_a_wider_excursion_wipes_out_the_memory_of_a_narrower_one(operator, before, low, inner, outer):
    """After low -> high -> low, an excursion inside [low, high] and back to low leaves no trace."""
    high = low + (RANGE_V - low) * max(inner, outer)
    operator.run(before)
    start = operator.run([low, high, low])[-1]
    inside = low + (high - low) * min(inner, outer)
    assert operator.run([inside, low])[-1] == pytest.approx(start, abs=1e-9)


@given(st.floats(0, 60), st.floats(5, 40), st.floats(0, 60))
def test_minor_loops_of_equal_size_are_congruent_at_every_bias(bias, size, other_bias):
    def loop(start):
        operator = PrandtlIshlinskii([0.0, 3.0, 8.0, 20.0], [0.7, 0.2, 0.2, 0.1])
        operator.run([start, start + size, start, start + size])
        return operator.run(start + size - size * np.array([0.0, 0.3, 0.8, 1.0, 0.6, 0.1, 0.0]))

    first, second = loop(bias), loop(other_bias)
    np.testing.assert_allclose(first - first[0], second - second[0], rtol=0, atol=1e-10)


@given(operators(), voltages, st.integers(2, 5))
def test_the_output_does_not_depend_on_how_fast_the_input_moves(operator, u, slower):
    twin = PrandtlIshlinskii(*operator.plays, *operator.dead_zones, offset=operator.offset, eps=1e-3)
    fine = np.interp(np.arange((u.size - 1) * slower + 1) / slower, np.arange(u.size), u)
    expected = operator.run(u)
    np.testing.assert_allclose(twin.run(fine)[::slower], expected, rtol=0, atol=1e-10 * (1 + np.abs(expected).max()))


@given(operators(), voltages, st.floats(0, RANGE_V), st.floats(0, 50))
def test_a_higher_input_never_gives_a_lower_output(operator, before, u, more):
    operator.run(before)
    twin = PrandtlIshlinskii(*operator.plays, *operator.dead_zones, offset=operator.offset, eps=1e-3)
    twin.set_states(operator.states)
    assert twin.step(u + more) >= operator.step(u) - 1e-9


@given(superpositions())
def test_inverting_a_table_twice_gives_it_back(table):
    again = inverse_table(*inverse_table(*table))
    np.testing.assert_allclose(again[0], table[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(again[1], table[1], rtol=0, atol=1e-9 * (1 + np.abs(table[1]).max()))


def test_inverting_two_sided_dead_zones_twice_gives_them_back():
    thresholds, weights = np.array([-40.0, -15.0, 0.0, 30.0, 80.0]), np.array([0.2, -0.3, 2.0, -0.2, 0.3])
    again = inverse_dead_zone(*inverse_dead_zone(thresholds, weights))
    np.testing.assert_allclose(again[0], thresholds, atol=1e-12)
    np.testing.assert_allclose(again[1], weights, atol=1e-12)


@given(st.lists(st.floats(0.0, 70.0), min_size=1, max_size=40))
def test_a_reset_cycle_leaves_states_that_do_not_depend_on_earlier_inputs(before):
    thresholds = np.array([0.0, 3.0, 20.0, 60.0, 90.0])
    operator = PrandtlIshlinskii(thresholds, [1.0, 0.1, 0.1, 0.1, 0.1])
    operator.run([*before, 0.0, RANGE_V, 0.0])
    np.testing.assert_allclose(operator.states, np.minimum(thresholds, RANGE_V - thresholds), atol=1e-12)
    operator.reset(RANGE_V)
    np.testing.assert_allclose(operator.states, np.minimum(thresholds, RANGE_V - thresholds), atol=1e-12)


def test_a_loading_curve_that_is_not_monotone_is_refused_with_index_and_value():
    with pytest.raises(ModelError, match=r"partial sum of weights 0\.\.2 is -0\.1, must be at least eps, 0\.01"):
        PrandtlIshlinskii([0.0, 1.0, 2.0], [1.0, -0.5, -0.6])


def test_dead_zones_that_are_not_monotone_below_zero_are_refused():
    with pytest.raises(ModelError, match=r"dead zones below 0: partial sum of weights 0\.\.1"):
        PrandtlIshlinskii([0.0], [1.0], [-5.0, 0.0, 5.0], [-2.5, 2.0, 0.1])


@pytest.mark.parametrize("thresholds", [[0.5, 1.0], [0.0, 0.0], [0.0, -1.0], [0.0, np.nan]])
def test_thresholds_that_do_not_increase_from_zero_are_refused(thresholds):
    with pytest.raises(ModelError, match="threshold"):
        PrandtlIshlinskii(thresholds, [1.0, 0.1])


def test_states_that_no_input_produces_are_refused():
    operator = typical_operator()
    with pytest.raises(ModelError, match=r"state 2 is 60, 58 from state 1, must be within 3"):
        operator.set_states([0.0, 2.0, 60.0, 12.0, 30.0])


@settings(max_examples=30)
@given(operators(), voltages)
def test_states_reached_by_driving_are_always_accepted(operator, u):
    operator.run(u)
    twin = PrandtlIshlinskii(*operator.plays, *operator.dead_zones, offset=operator.offset, eps=1e-3)
    twin.set_states(operator.states)
    np.testing.assert_array_equal(twin.states, operator.states)


def test_dead_zones_that_are_not_shifted_keep_their_table():
    thresholds, weights = np.array([-3.0, -1.0, 0.0, 2.0, 5.0]), np.array([0.2, -0.1, 1.5, 0.4, -0.3])
    moved, same, constant = shifted(thresholds, weights, 0.0)
    order, expected = np.argsort(moved), thresholds
    np.testing.assert_array_equal(moved[order], expected)
    np.testing.assert_array_equal(same[order], weights)
    assert constant == 0.0
