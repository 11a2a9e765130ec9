"""The Bouc-Wen hysteresis against its closed forms and an integration of its equation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from piezod.effects.kernels import bouc_wen

NO_PATH = np.empty(0)
RISEN = 1.0 - np.exp(-1.0)
shapes = pytest.mark.parametrize(("exponent", "closing"), [(1.0, 1.0), (0.5, 0.3), (1.5, 0.5), (3.0, 0.7), (8.0, 0.5)])


def test_with_exponent_and_closing_of_one_it_is_dahl_s_friction():
    position = np.concatenate((np.linspace(0.0, 2.0, 201), np.linspace(2.0, -3.0, 501)))
    up = 1.0 - np.exp(-position[:201])
    down = -1.0 + (1.0 + up[-1]) * np.exp(position[201:] - 2.0)
    np.testing.assert_allclose(bouc_wen(NO_PATH, position, 1.0, 1.0, 1.0), np.concatenate((up, down)), atol=1e-8)


@shapes
@pytest.mark.parametrize("parts", [1, 7, 1000])
def test_the_state_is_63_percent_after_the_travel_in_any_number_of_parts(exponent, closing, parts):
    states = bouc_wen(NO_PATH, np.linspace(0.0, 5.0, parts + 1), 5.0, exponent, closing)
    assert states[-1] == pytest.approx(RISEN, rel=1e-9)


@shapes
def test_the_states_agree_with_an_integration_of_the_equation(exponent, closing):
    scale = quad(lambda z: 1.0 / (1.0 - z**exponent), 0.0, RISEN)[0]
    turns = np.array([0.0, 0.7, -0.4, 2.5, 1.0, 1.6, -3.0])
    z, expected = 0.0, [0.0]
    for movement in np.diff(turns):
        sign = np.sign(movement)

        def rate(_, z, sign=sign):
            return sign * (1.0 - np.abs(z) ** exponent * (closing * np.sign(sign * z) + 1.0 - closing))

        solved = solve_ivp(rate, (0.0, scale * abs(movement)), [z], rtol=1e-10, atol=1e-12, max_step=0.01)
        z = float(solved.y[0, -1])
        expected.append(z)
    steep = 1e-4 if exponent < 1.0 else 1e-6  # a root's slope is infinite at 0
    np.testing.assert_allclose(bouc_wen(NO_PATH, turns, 1.0, exponent, closing), expected, atol=steep)


@shapes
def test_a_path_before_the_record_gives_the_states_of_the_whole_movement(exponent, closing):
    position = np.array([0.0, 3.0, -1.0, 0.5, 0.2])
    whole = bouc_wen(NO_PATH, position, 1.0, exponent, closing)
    np.testing.assert_array_equal(bouc_wen(position[:3], position[3:], 1.0, exponent, closing), whole[3:])


@shapes
@given(travels=st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=60))
def test_the_state_stays_within_1(exponent, closing, travels):
    states = bouc_wen(NO_PATH, np.cumsum([0.0, *travels]), 1.0, exponent, closing)
    assert np.abs(states).max() <= 1.0


@pytest.mark.parametrize("shape", [(0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (float("nan"), 1.0, 1.0), (1.0, 1.0, 0.0)])
def test_a_travel_or_a_shape_outside_its_range_is_refused(shape):
    with pytest.raises(ValueError, match="above 0"):
        bouc_wen(NO_PATH, np.zeros(3), *shape)
