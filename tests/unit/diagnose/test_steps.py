"""Edges of load steps: found to the sample, and none where the command leaps."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.candidates.steps import NEVER_S, Step, edge_near, has_clear_edges, shown_late_s
from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.terms import Term
from piezod.effects import EFFECTS
from tests.unit.diagnose.residuals import mixed_work, noise, series, time

TIME_S = time(20_000)
ON_S, HEIGHT_N = 7.3, 2.0


def stepped(seed, height_N=HEIGHT_N):
    return noise(TIME_S.size, 0.0, np.random.default_rng(seed)) + height_N * (TIME_S >= ON_S)


@pytest.mark.parametrize("guess_s", [7.1, 7.3, 7.5])
def test_an_edge_is_found_to_a_few_samples_from_a_quarter_of_a_second_away(guess_s):
    for seed in range(5):
        residual = stepped(seed)
        one = series(TIME_S, mixed_work(TIME_S), residual)
        assert edge_near(one, residual, guess_s) == pytest.approx(ON_S, abs=0.005)


def test_an_edge_where_no_reading_counts_stays_where_it_was():
    residual = stepped(0)
    one = series(TIME_S, mixed_work(TIME_S), residual, counts=TIME_S < 5.0)
    assert edge_near(one, residual, ON_S) == ON_S


def left_by(one, residual, height_N):
    step = Step(height_N, round(ON_S / one.dt_s), round(NEVER_S / one.dt_s))
    return has_clear_edges(one, residual - height_N * (TIME_S >= ON_S), step)


def test_a_step_of_the_load_has_a_sharp_edge_and_a_drift_has_none():
    u = mixed_work(TIME_S)
    for seed in range(5):
        residual = stepped(seed)
        assert left_by(series(TIME_S, u, residual), residual, HEIGHT_N)
        drifting = noise(TIME_S.size, 0.0, np.random.default_rng(seed)) + 0.5 * HEIGHT_N * TIME_S / ON_S
        assert not left_by(series(TIME_S, u, drifting), drifting, HEIGHT_N)


def test_what_jumps_where_the_command_leaps_is_no_step_of_the_load():
    u = mixed_work(TIME_S)
    u[TIME_S >= ON_S] += 150.0
    residual = stepped(1)
    assert not left_by(series(TIME_S, u, residual), residual, HEIGHT_N)


@pytest.mark.parametrize("phase", np.linspace(0.0, np.pi, 9))
def test_no_swing_leaps_wherever_a_step_falls(phase):
    residual = stepped(1)
    u = 60.0 + 50.0 * np.sin(4.0 * np.pi * (TIME_S - ON_S) + phase)
    assert left_by(series(TIME_S, u, residual), residual, HEIGHT_N)


@pytest.mark.parametrize(("answer", "believed"), [(0.0, True), (1.0, False)])
def test_a_jump_at_a_step_of_the_command_must_be_larger_than_at_its_other_steps(answer, believed):
    steps_s = np.arange(1.0, 19.0, 1.05)
    u = np.zeros(TIME_S.size)
    residual = noise(TIME_S.size, 0.0, np.random.default_rng(7))
    for k, at_s in enumerate(steps_s):
        u[at_s <= TIME_S] += 20.0 * (-1.0) ** k
        residual += answer * (-1.0) ** k * (at_s <= TIME_S)
    step = Step(HEIGHT_N, round(steps_s[6] / 1e-3), TIME_S.size)
    height_N = np.where(steps_s[6] <= TIME_S, HEIGHT_N - answer, 0.0)  # with the command's own part HEIGHT_N in all
    left = residual + height_N - HEIGHT_N * (steps_s[6] <= TIME_S)
    assert has_clear_edges(series(TIME_S, u, residual), left, step) == believed


@pytest.mark.parametrize("edges", [(7.3, NEVER_S), (7.3, 12.0), (-1.0, 7.3)])
@pytest.mark.parametrize(
    ("behind", "values", "late_s"),
    [
        ((), (), 0.0),
        ((("transport_delay", ()),), ({"delay_s": 0.0534},), 0.0534),
        ((("sensor_filter", (("order", 1.0),)),), ({"cutoff_Hz": 3.0},), np.log(2.0) / (2.0 * np.pi * 3.0)),
        ((("electrical_lag", ()),), ({"time_constant_s": 0.05},), 0.0),
    ],
)
def test_an_edge_shows_as_late_as_what_stands_behind_the_mechanics_makes_it(behind, values, late_s, edges):
    one = series(TIME_S, mixed_work(TIME_S), np.zeros(TIME_S.size))
    chain = Chain([one], PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)
    terms = [Term(EFFECTS[name], "since", choices=choices) for name, choices in behind]
    step = {"step_N": 2.0, "on_s": edges[0], "off_s": edges[1], "rise_s": 0.002}
    point = replace(empty_point(chain, 1.8, 0.0), values=(*values, step))
    terms.append(Term(EFFECTS["load_step"], "once", 0))
    assert shown_late_s(chain, terms, point) == pytest.approx(late_s, abs=1.1 * one.dt_s)
