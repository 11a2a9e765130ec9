"""Clocks of different rates, seen directly: by how much, and nothing where there is none."""

import numpy as np
import pytest

from piezod.diagnose.candidates.direct import SKEWS_PPM, skew_ppm
from tests.unit.diagnose.residuals import mixed_work, model_of, noise, series, time

SAMPLES, NOISE_N = 60_000, 2.0


def made(true_ppm, seed):
    seconds = time(SAMPLES)
    modelled_N = model_of(mixed_work(seconds))
    reading_N = 3.0 + 1.1 * np.interp(seconds * (1.0 + 1e-6 * true_ppm), seconds, modelled_N)
    return series(
        seconds, mixed_work(seconds), reading_N + NOISE_N * noise(SAMPLES, 0.9, np.random.default_rng(seed))
    ), modelled_N


@pytest.mark.parametrize("true_ppm", [-15_000.0, -1900.0, -300.0, 300.0, 1900.0, 15_000.0])
def test_a_skew_is_seen_to_the_next_that_is_tried(true_ppm):
    found = skew_ppm(*made(true_ppm, 1))
    apart = SKEWS_PPM[1] / SKEWS_PPM[0]
    assert 1.0 / apart <= found / true_ppm <= apart


@pytest.mark.parametrize("seed", range(5))
def test_no_skew_is_seen_where_there_is_none(seed):
    assert skew_ppm(*made(0.0, seed)) is None
