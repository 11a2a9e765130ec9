"""The scales of fitted parameters."""

import pytest

from piezod.diagnose.hypothesis.layout import scaled, unscaled
from piezod.effects import EFFECTS


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS.keys())
def test_a_step_of_any_size_stays_in_the_range_of_the_parameter(effect):
    """Without a warning, which is an error here."""
    for parameter in effect.parameters:
        assert unscaled(parameter, 1e5) <= parameter.high
        assert unscaled(parameter, -1e5) >= parameter.low
        middle = 0.5 * (parameter.low + min(parameter.high, 1e6))
        assert unscaled(parameter, scaled(parameter, middle)) == pytest.approx(middle, rel=1e-12)
