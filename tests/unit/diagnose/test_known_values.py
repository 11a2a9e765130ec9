"""A value has changed where the information on the old one excludes the new one; otherwise both are averaged."""

import numpy as np
import pytest

from piezod.diagnose.hypothesis.left_out import FORM_ERROR, INTERVAL_FACTOR, covariance
from piezod.diagnose.selection.known_values import JointEstimate, agreeing, averaged, covariance_of


def estimates(**p_values):
    return {name: JointEstimate(p, {}, {}) for name, p in p_values.items()}


@pytest.mark.parametrize(
    ("effects", "changed"),
    [(2, {"creep", "friction"}), (4, {"creep"}), (6, set())],  # limits k * 5 % / effects of Benjamini and Hochberg
)
def test_the_more_effects_are_tested_the_smaller_a_p_value_has_to_be(effects, changed):
    tested = estimates(creep=0.01, friction=0.04)
    assert set(agreeing(tested, effects)) == set(tested) - changed


def test_two_estimates_are_averaged_by_their_variances_and_differ_by_chance_as_chi_square_says():
    p, joint, both = averaged(np.zeros(2), np.array([0.0, 5.0]), np.eye(2), np.eye(2))
    assert p == pytest.approx(np.exp(-0.5 * 12.5))  # chi-square with two degrees of freedom is an exponential law
    np.testing.assert_allclose(joint, [0.0, 2.5])
    np.testing.assert_allclose(both, 0.5 * np.eye(2))


def test_a_direction_without_information_takes_the_new_estimate_and_shows_no_change():
    only_the_sum = np.array([[1.0, 1.0], [1.0, 1.0]])
    p, joint, _ = averaged(np.zeros(2), np.array([9.0, -9.0]), covariance_of(only_the_sum), np.eye(2))
    assert p > 0.99
    np.testing.assert_allclose(joint, [9.0, -9.0], rtol=1e-6)


def test_the_covariance_is_that_of_the_jackknife_widened_by_the_error_of_the_form():
    moves = np.array([[0.1, 0.0], [-0.1, 0.0], [0.1, 0.3], [-0.1, -0.3]])
    expected = 0.75 * INTERVAL_FACTOR**2 * np.array([[0.04, 0.06], [0.06, 0.18]]) + np.diag([FORM_ERROR**2, 0.0])
    np.testing.assert_allclose(covariance(moves, np.array([FORM_ERROR, 0.0])), expected)
