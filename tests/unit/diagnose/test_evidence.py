"""What the readings show without a fit, beside the model with all that was found."""

import numpy as np
import pytest

from piezod.diagnose.verdict.evidence import read_off, standing
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
    found = read_off([recorded], {0: [STRETCH]}, [reading_N - force_N], 1.0)
    assert [one.name for one in found] == ["sensor_dropout"] * named
    left = standing([recorded], {0: [STRETCH], 1: []}, [reading_N - force_N, reading_N])
    assert left == {0: [STRETCH] * named, 1: []}
