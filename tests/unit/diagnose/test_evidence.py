"""What the readings show without a fit, beside the model with all that was found."""

import numpy as np
import pytest

from piezod.diagnose.hypothesis.left_out import FORM_ERROR, INTERVAL_FACTOR
from piezod.diagnose.verdict.direct_findings import confirmed_frozen, direct_findings
from piezod.diagnose.verdict.evidence import widened
from piezod.effects import EFFECTS
from tests.unit.diagnose.residuals import mixed_work, noise, series, time

SAMPLES, STRETCH = 4000, (1000, 1020)


@pytest.mark.parametrize(("stands", "named"), [("not", False), ("with noise", True), ("to the last bit", True)])
def test_a_reading_that_the_found_model_explains_does_not_stand_still(stands, named):
    time_s = time(SAMPLES)
    force_N = mixed_work(time_s) + 100.0
    reading_N = force_N + noise(SAMPLES, 0.0, np.random.default_rng(4))
    first, end = STRETCH
    if stands == "with noise":
        reading_N[first:end] -= force_N[first:end] - force_N[first] + 20.0
    elif stands == "to the last bit":
        reading_N[first:end] = force_N[first]
    recorded = series(time_s, mixed_work(time_s), reading_N)
    found = direct_findings([recorded], {0: [STRETCH]}, [reading_N - force_N], 1.0)
    assert [one.name for one in found] == ["sensor_dropout"] * named
    left = confirmed_frozen([recorded], {0: [STRETCH], 1: []}, [reading_N - force_N, reading_N])
    assert left == {0: [STRETCH] * named, 1: []}


@pytest.mark.parametrize(
    ("effect", "name", "value", "half", "systematic", "expected"),
    [
        (
            "slew_limit",
            "limit_V_per_s",
            300.0,
            0.0,
            0.0,
            (300.0 * (1.0 - FORM_ERROR), 300.0 * (1.0 + FORM_ERROR)),
        ),  # told exactly
        (
            "feedthrough",
            "coefficient_N_s_per_V",
            1.0,
            0.2,
            0.0,
            (1.0 - INTERVAL_FACTOR * 0.2, 1.0 + INTERVAL_FACTOR * 0.2),
        ),
        ("feedthrough", "coefficient_N_s_per_V", 1.0, 0.2, 0.3, (0.5, 1.5)),  # 0.4 and 0.3 in squares
        ("feedthrough", "coefficient_N_s_per_V", 1.0, 0.2, 2.0, (0.6 / 3.0396, 3.0396)),  # the sign is known
        ("feedthrough", "coefficient_N_s_per_V", -1.0, 0.2, 2.0, (-3.0396, -0.6 / 3.0396)),
        ("slew_limit", "limit_V_per_s", 300.0, 0.0, np.log(3.0), (100.0, 900.0)),  # by a factor
        ("creep", "per_decade", 0.02, 0.01, 0.0, (0.01, 0.04)),  # above 0, by a factor
        ("creep", "per_decade", 0.02, 1.0, 0.0, (0.0, 0.3)),  # within the range of the parameter
    ],
)
def test_an_interval_holds_what_the_form_of_the_model_is_off_by(effect, name, value, half, systematic, expected):
    one = EFFECTS[effect].parameter(name)
    in_fit = max(value - half, one.low), min(value + half, one.high)
    low, high = widened(one, value, in_fit, systematic)
    assert (low, high) == pytest.approx(expected, rel=1e-3)
    assert one.low <= low <= in_fit[0]
    assert in_fit[1] <= high <= one.high
