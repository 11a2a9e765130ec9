"""The cores that a concealed stack may have: as wide as they should be, with the memory that they should have."""

from itertools import pairwise

import numpy as np
import pytest

from firmware_sim.concealed.plant.hysteresis import (
    LEAST_OPENING,
    MOST_OPENING,
    draw_hysteresis,
    draw_noncongruent,
    loop_opening,
    major_cycles,
)
from firmware_sim.concealed.plant.stops import Stops, master_curve

KINDS = ("preisach", "bouc_wen", "plays")
REACH_V = 120.0


def path(*levels_V):
    corners = np.array(levels_V, dtype=float)
    return np.concatenate([np.linspace(a, b, 400)[:-1] for a, b in pairwise(corners)] + [corners[-1:]])


def core(kind, seed=1):
    return draw_hysteresis(np.random.default_rng(seed), kind, REACH_V)


def loop_width(stroke):
    """Of the last loop, which is 2 x 400 points."""
    up, down = stroke[-799:-399], stroke[-400:][::-1]
    return np.max(np.abs(up - down))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_major_loop_opens_by_8_to_15_percent(kind, seed):
    opening = loop_opening(core(kind, seed).run(major_cycles(REACH_V)))
    assert LEAST_OPENING - 0.002 <= opening <= MOST_OPENING + 0.002


@pytest.mark.parametrize("kind", KINDS)
def test_the_virgin_curve_ends_at_the_reach(kind):
    assert core(kind).run(path(0, REACH_V))[-1] == pytest.approx(REACH_V, rel=1e-3)


@pytest.mark.parametrize("kind", ["preisach", "plays"])
def test_passing_an_old_reversal_wipes_out_what_came_after(kind):
    plain, detour = path(0, 100, 20, 110), path(0, 100, 20, 60, 40, 70, 30, 110)
    assert core(kind).run(detour)[-1] == pytest.approx(core(kind).run(plain)[-1], abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_minor_loops_of_a_size_are_congruent_at_every_bias(kind):
    widths = [
        loop_width(core(kind).run(path(0, REACH_V, 0, *([bias - 15, bias + 15] * 4), bias - 15))) for bias in (20, 90)
    ]
    assert widths[0] == pytest.approx(widths[1], rel=0.05 if kind == "bouc_wen" else 0.005)


@pytest.mark.parametrize("seed", range(4))
def test_a_noncongruent_core_cannot_be_followed_by_plays_and_the_others_can(seed):
    rng = np.random.default_rng(seed)
    voltage_V = path(0, REACH_V, *rng.uniform(0, REACH_V, 80))
    widths = REACH_V * np.linspace(0, 1, 60) ** 1.3
    states = np.zeros(60)
    columns = np.empty((voltage_V.size, 61))
    for k, u in enumerate(voltage_V):
        states = np.maximum(u - widths, np.minimum(u + widths, states))
        columns[k] = [*states, 1.0]

    def misfit(stroke):
        left = stroke - columns @ np.linalg.lstsq(columns, stroke, rcond=None)[0]
        return np.std(left) / REACH_V

    for kind in KINDS:
        assert misfit(draw_hysteresis(np.random.default_rng(seed), kind, REACH_V).run(voltage_V)) < 5e-4
    assert misfit(draw_noncongruent(np.random.default_rng(seed), REACH_V).run(voltage_V)) > 2e-3


def test_a_smooth_stop_follows_its_equation():
    """dz/du = 1 - (z/r)^n in small Euler steps."""
    stops = Stops(np.array([5.0]), np.array([1.0]), 3.0)
    voltage_V = path(0, 12, 3, 9)
    z, euler = 0.0, []
    for du in np.diff(voltage_V, prepend=0.0):
        for _ in range(50):
            z += du / 50 * (1.0 - (abs(z) / 5.0) ** 3 if z * du > 0 else 1.0)
        euler.append(z)
    assert stops.run(voltage_V) == pytest.approx(np.array(euler), abs=0.02)


def test_the_master_curve_of_exponent_one_is_a_logarithm():
    size, travel = master_curve(1.0)
    inside = size < 0.999
    assert travel[inside] == pytest.approx(-np.log1p(-size[inside]), rel=1e-4, abs=1e-9)
