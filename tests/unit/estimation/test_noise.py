"""Noise from repeats and rests, whatever a model leaves."""

import numpy as np
import pytest

from piezod.estimation.noise import noise_of

RATE_HZ = 500.0
TIME_S = np.arange(20_000) / RATE_HZ
TRIANGLES = 50.0 * (1.0 - np.abs((0.5 * TIME_S) % 2.0 - 1.0))
RESTS = np.repeat(np.array([0.0, 40.0, 80.0, 20.0, 60.0] * 4), 1000)


def found(u, noise_N, shape=None, counts=None):
    y = 2.0 * u + 0.3 * u * np.sin(0.1 * u) if shape is None else shape
    y = y + noise_N * np.random.default_rng(7).normal(size=u.size)
    return noise_of(u, y, np.ones(u.size, bool) if counts is None else counts, 1.0 / RATE_HZ)


@pytest.mark.parametrize("noise_N", [0.01, 0.3, 2.0])
def test_repeats_tell_the_noise_to_5_percent_whatever_the_law_of_the_output(noise_N):
    noise = found(TRIANGLES, noise_N)
    assert noise.seen_in == "repeats"
    assert noise.rms == pytest.approx(noise_N, rel=0.05)


def test_rests_tell_the_noise_where_nothing_repeats():
    noise = found(RESTS * (1.0 + 0.01 * (np.arange(RESTS.size) // 1000)), 0.3)
    assert noise.seen_in == "rests"
    assert noise.rms == pytest.approx(0.3, rel=0.05)


def test_samples_that_do_not_count_tell_nothing():
    counts = np.ones(TRIANGLES.size, bool)
    counts[5000:6000] = False
    y = 2.0 * TRIANGLES + 500.0 * ~counts
    assert found(TRIANGLES, 0.3, y, counts).rms == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize(
    "u",
    [
        TRIANGLES * (1.0 + 0.02 * TIME_S),
        50.0 + 50.0 * np.sin(2.0 * np.pi * 0.02 * TIME_S**1.6),
        np.cumsum(np.random.default_rng(3).normal(size=TIME_S.size)),
    ],
    ids=["growing", "chirp", "random"],
)
def test_an_input_that_neither_repeats_nor_rests_tells_none(u):
    assert found(u, 0.3) is None
