"""How the readings change with the base, against differences of the whole chain."""

import numpy as np
import pytest

from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.effects import EFFECTS
from tests.unit.diagnose.residuals import mixed_work, series, time
from tests.unit.diagnose.test_corners import many_plays

SAMPLES, RATE_HZ = 4000, 200.0
BEHIND = [
    (),
    ("creep",),
    ("gain_drift", "output_nonlinearity"),
    ("sensor_filter",),
    ("creep", "output_nonlinearity", "charge_leakage", "vibration"),
    ("voltage_clamp", "contact_gap", "resonance"),
    ("rate_dependent_hysteresis", "feedthrough"),
    ("creep", "noncongruent_minor_loops", "gain_drift", "sensor_filter"),
    ("noncongruent_minor_loops", "output_nonlinearity"),
]


def term_of(name):
    effect = EFFECTS[name]
    choices = tuple((one.name, one.search.choices[0]) for one in effect.parameters if one.search.choices)
    return Term(effect, "already", choices=choices), {
        one.name: one.search.starts[-1] for one in effect.parameters if not one.search.choices
    }


@pytest.mark.parametrize("names", BEHIND)
def test_tangents_are_what_a_small_change_of_each_column_does(names):
    seconds, rng = time(SAMPLES, RATE_HZ), np.random.default_rng(5)
    u = mixed_work(seconds)
    density = PlayDensity.up_to(119.4).beside(np.array([20.0]), np.eye(1))
    law = ForceLaw(-4.0, 120.0).beside(np.array([40.0]), np.eye(1))
    chain = Chain([series(seconds, u, many_plays(u))], density, law, 216.0, most_rows=1000)
    terms, values = zip(*map(term_of, names), strict=True) if names else ((), ())
    bent = chain.law.straight(0.0, 1.8) * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, law.count))
    point = Point(0.3 * rng.uniform(0.0, 1.0, density.count), bent, np.zeros(1), values)
    weights = [(k, name) for k, term in enumerate(terms) for name in term.effect.weights]
    found = chain.tangents(0, terms, point)
    base = density.count + law.count
    assert found.shape == (1000, base + len(weights))
    for k in range(base + len(weights)):
        sides, size = [], 1e-3 if k < base else 1e-5  # V, and parts of half the voltage's range
        for sign in (1.0, -1.0):
            both, moved_values = np.concatenate((point.density, point.law)), [*map(dict, values)]
            if k < base:
                both[k] += sign * size
            else:
                term, name = weights[k - base]
                moved_values[term][name] += sign * size
            moved = Point(both[: density.count], both[density.count :], point.offsets_N, tuple(moved_values))
            sides.append(chain.compared(0, terms, moved))
        difference = (sides[0] - sides[1]) / (2.0 * size)
        reach = np.abs(difference).max()
        near = np.abs(found[:, k] - difference) <= 1e-5 * reach + 1e-9
        assert np.mean(near) > 0.995, k  # at a corner of the chain the two sides differ


@pytest.mark.parametrize(
    "names", [*BEHIND, ("electrical_lag",), ("voltage_clamp", "gain_drift", "load_step"), ("friction",)]
)
@pytest.mark.parametrize("noisy", [False, True])
def test_what_is_compared_is_the_simulation_at_these_samples(names, noisy):
    seconds = time(SAMPLES, RATE_HZ)
    u = np.round(mixed_work(seconds), 3)
    u[1000:1200] = u[1000]  # a hold
    if noisy:
        u = u + np.random.default_rng(3).normal(0.0, 0.5, u.size)  # it turns within every step
    chain = Chain([series(seconds, u, many_plays(u))], PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0, 500)
    terms, values = zip(*map(term_of, names), strict=True) if names else ((), ())
    density = 0.3 * np.random.default_rng(5).uniform(0.0, 1.0, chain.density.count)
    point = Point(density, chain.law.straight(0.0, 1.8), np.zeros(1), values)
    whole = chain.run(0, terms, point).reading_N
    assert chain.rows[0].step == 8
    np.testing.assert_allclose(chain.compared(0, terms, point), whole[chain.rows[0]], rtol=0.0, atol=1e-9)
