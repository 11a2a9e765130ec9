"""The p-value of an effect, and its adjustment over all names."""

import numpy as np
import pytest

from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.left_out import sign_test_p
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.significance import discovery_rates, is_concentrated, p_value
from piezod.effects import EFFECTS
from tests.unit.diagnose.test_pairs import stairs, worked


def test_gains_by_chance_give_p_values_that_are_spread_evenly():
    rng = np.random.default_rng(1)
    found = np.array([sign_test_p(rng.normal(0.0, 0.1, 24)) for _ in range(400)])
    for level in (0.05, 0.2, 0.5):
        spread = np.sqrt(level * (1.0 - level) / found.size)
        assert abs(np.mean(found <= level) - level) < 3.0 * spread


def test_a_gain_in_every_block_is_as_unlikely_as_the_signs_allow():
    assert sign_test_p(np.full(8, 0.1)) == pytest.approx(2.0**-8, rel=0.2)


def test_one_block_alone_proves_nothing():
    assert sign_test_p(np.concatenate(([5.0], np.zeros(11)))) > 0.3
    assert sign_test_p(np.array([5.0])) == 1.0


@pytest.mark.parametrize(("blocks", "few"), [(2, True), (4, True), (6, False), (30, False)])
def test_what_acts_in_less_than_five_blocks_cannot_be_tested_by_signs(blocks, few):
    gains = np.random.default_rng(3).normal(0.0, 0.005, 60)
    gains[:blocks] += 1.0
    assert is_concentrated(gains) == few


@pytest.mark.parametrize(
    ("p_values", "expected"),
    [
        ([0.001], [0.022]),
        ([0.001, 0.002], [0.022, 0.022]),
        ([0.002, 0.5, 0.001], [0.022, 1.0, 0.022]),
        ([0.02], [0.44]),
        ([], []),
    ],
)
def test_values_are_adjusted_over_the_22_names_of_the_catalogue(p_values, expected):
    assert len(EFFECTS) == 22
    assert discovery_rates(p_values) == pytest.approx(expected)


def searched(read, name, values):
    """A search that ended with an effect, the hypothesis without it, and the effect."""
    chain, start = worked(np.random.default_rng(6), read, stairs(np.random.default_rng(7)))
    base = fit(chain, (), start)
    point = Point(base.point.density, base.point.law, base.point.offsets_N, (values,))
    found = fit(chain, (Term(EFFECTS[name], "since"),), point)
    return Search(chain, base, found, base.point), base, name


def test_an_effect_that_is_there_is_significant_and_one_that_is_not_is_not():
    def late(force_N, _u, role):
        return force_N if role == "identification" else np.concatenate((np.full(3, force_N[0]), force_N[:-3]))

    def sound(force_N, _u, _role):
        return force_N

    assert p_value(*searched(late, "transport_delay", {"delay_s": 2e-3})) < 1e-3
    assert p_value(*searched(sound, "output_nonlinearity", {"curvature": 0.0, "cubic": 0.0})) > 0.02
