"""Errors that left-out blocks do not show: an unknown time of the readings, and effects that imitate each other."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.systematic import systematic_errors
from piezod.diagnose.hypothesis.terms import Term
from piezod.effects import EFFECTS
from piezod.recording.hold import STRAIGHT
from tests.unit.diagnose.residuals import lagged, mixed_work, noise, series, time
from tests.unit.diagnose.test_corners import many_plays

SAMPLES, RATE_HZ, FINE = 6_000, 200.0, 50
LAG_S, NOISE_N, MUCH_NOISE_N = 0.03, 1.0, 4.0


def fitted(names, *, late=0.0, stated=None, values=(), noise_N=NOISE_N):
    """Fit of a bench with a lag whose readings come `late` samples after their commands."""
    seconds, rng, made = time(SAMPLES, RATE_HZ), np.random.default_rng(3), []
    for role in ("identification", "recording"):
        u = mixed_work(seconds)
        fine_V = np.interp(time((SAMPLES - 1) * FINE + 1, FINE * RATE_HZ), seconds, u)
        lagged_V = lagged(fine_V, LAG_S, FINE * RATE_HZ)
        read_V = np.interp(seconds + late / RATE_HZ, time(fine_V.size, FINE * RATE_HZ), lagged_V)
        force_N = many_plays(u if role == "identification" else read_V) + noise_N * noise(SAMPLES, 0.0, rng)
        one = series(seconds, u, force_N, noise_N, role=role)
        made.append(replace(one, hold=STRAIGHT, recorded_hold=stated if role == "recording" else None))
    chain = Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)
    terms = tuple(Term(EFFECTS[name], "since") for name in names)
    point = replace(empty_point(chain, 1.8, 0.0), values=values or ({"time_constant_s": LAG_S, "swell": 0.0},))
    return chain, fit(chain, terms, point)


@pytest.mark.parametrize("late", [-0.5, 0.5])
def test_a_lag_is_known_to_the_time_of_its_readings_if_that_is_lost_in_noise(late):
    chain, found = fitted(["electrical_lag"], late=late, noise_N=MUCH_NOISE_N)
    value = found.point.values[0]["time_constant_s"]
    error, spread = systematic_errors(chain, found)[0]["time_constant_s"], found.spread[0]["time_constant_s"]
    # the half sample passes for a part of the lag
    assert value / LAG_S == pytest.approx(1.0 - late / RATE_HZ / LAG_S, abs=0.02)
    assert abs(np.log(value / LAG_S)) < np.hypot(2.0 * 1.96 * spread, error) < np.log(1.2)


def test_a_stated_hold_leaves_the_error_of_the_form():
    unknown, stated = fitted(["electrical_lag"]), fitted(["electrical_lag"], stated=STRAIGHT)
    errors = [systematic_errors(*one)[0]["time_constant_s"] for one in (unknown, stated)]
    assert errors[1] < 0.02 < errors[0]


def test_a_parameter_that_another_effect_imitates_has_a_larger_error_even_if_that_is_held():
    alone = systematic_errors(*fitted(["electrical_lag"], stated=STRAIGHT))[0]["time_constant_s"]
    names = ["electrical_lag", "transport_delay"]
    values = ({"time_constant_s": LAG_S, "swell": 0.0}, {"delay_s": 1e-4})
    chain, found = fitted(names, stated=STRAIGHT, values=values)
    beside = systematic_errors(chain, found)[0]["time_constant_s"]
    held = replace(found, terms=(found.terms[0], replace(found.terms[1], held=True)))
    assert beside > 1.1 * alone
    assert systematic_errors(chain, held)[0]["time_constant_s"] == pytest.approx(beside)
