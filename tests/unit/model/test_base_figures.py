"""Gain and loop width of the stack follow from its operators."""

import pytest

from piezod.model.base_figures import base_figures
from piezod.model.parameters import Hysteresis, Superposition


@pytest.mark.parametrize(("low", "high"), [(0.0, 100.0), (-20.0, 60.0), (10.0, 50.0)])
def test_one_play_before_a_straight_law_has_the_gain_and_the_loop_of_its_definition(low, high):
    straight, play, width, slope = 0.7, 0.3, 5.0, 2.0
    hysteresis = Hysteresis(
        plays=Superposition(thresholds=(0.0, width), weights=(straight, play)),
        dead_zones=Superposition(thresholds=(0.0,), weights=(slope,)),
        offset=3.0,
    )
    figures = base_figures(hysteresis, low, high)
    span = slope * (straight * (high - low) + play * (high - low - 2.0 * width))
    opening = slope * play * (2.0 * width - 4.0 * width**2 / (high - low))  # mean of its rise, plateau and fall
    assert figures.gain == pytest.approx(span / (high - low))
    assert figures.loop_width_percent == pytest.approx(100.0 * opening / span, rel=1e-4)
