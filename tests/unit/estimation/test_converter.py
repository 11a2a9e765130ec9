"""A coarse converter's rounding undone, held against the signal in front of the converter."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from piezod.estimation.recordings.converter import converter_step_N, unrounded
from piezod.estimation.recordings.series import Series

Array = NDArray[np.float64]

STEP_N, NOISE_N, DT_S = 2.0, 0.1, 1e-3
TIME_S = DT_S * np.arange(20_000)
MOVING_N = 60.0 * np.sin(2.0 * np.pi * 0.3 * TIME_S) + 20.0 * np.sin(2.0 * np.pi * 2.7 * TIME_S)
STAIRCASE_N = 13.3 * np.floor(TIME_S / 0.5) % 97.0
ALL = slice(None)


def recorded(force_N: Array, step_N: float, noise_N: float) -> Series:
    noise = noise_N * np.random.default_rng(3).standard_normal(force_N.size)
    readings = step_N * np.rint((force_N + noise) / step_N) if step_N else force_N + noise
    everywhere = np.ones(force_N.size, dtype=bool)
    return Series(
        "r", "recording", TIME_S, force_N, readings, everywhere, noise_N, lattice_N=converter_step_N(readings)
    )


@pytest.mark.parametrize("step_N", [0.25, 2.0])
def test_the_step_of_a_lattice_is_read_off(step_N: float) -> None:
    assert recorded(MOVING_N, step_N, NOISE_N).lattice_N == pytest.approx(step_N)


def test_readings_without_a_lattice_stay_as_they_are() -> None:
    fine = recorded(MOVING_N, 0.0, NOISE_N)
    assert fine.lattice_N == 0.0
    assert unrounded(fine) is fine


def test_a_lattice_finer_than_the_noise_reads_between_its_steps() -> None:
    dithered = recorded(MOVING_N, 2.0 * NOISE_N, NOISE_N)
    assert unrounded(dithered) is dithered


@pytest.mark.parametrize("force_N", [MOVING_N, STAIRCASE_N, MOVING_N + STAIRCASE_N], ids=["moving", "steps", "both"])
def test_an_unrounded_force_is_within_its_claimed_error(force_N: Array) -> None:
    one = unrounded(recorded(force_N, STEP_N, NOISE_N))
    assert one.trust is not None
    assert one.within_N is not None
    tells = one.within_N == 0.0
    claimed_N = one.noise_N / one.trust[tells]
    in_claims = (one.fitted_N(ALL) - force_N)[tells] / claimed_N
    assert np.sqrt(np.mean(in_claims**2)) < 1.3
    assert claimed_N.min() < 2.0 * NOISE_N or not np.any(np.abs(np.diff(force_N)) < 0.2)


@pytest.mark.parametrize("force_N", [MOVING_N, STAIRCASE_N], ids=["moving", "steps"])
def test_the_force_is_hardly_ever_farther_off_than_a_long_run_allows(force_N: Array) -> None:
    one = unrounded(recorded(force_N, STEP_N, NOISE_N))
    assert one.within_N is not None
    long = one.within_N > 0.0
    assert long.any()
    assert np.mean((np.abs(one.fitted_N(ALL) - force_N) > one.within_N)[long]) < 0.01
    assert np.all(one.within_N[long] < 0.75 * STEP_N)


def test_a_moving_force_is_told_better_than_by_the_readings() -> None:
    one = unrounded(recorded(MOVING_N, STEP_N, NOISE_N))
    weights = np.where(one.within_N == 0.0, one.weights(ALL), 0.0)
    error_N = np.sqrt(np.mean((weights * (one.fitted_N(ALL) - MOVING_N)) ** 2) / np.mean(weights**2))
    assert error_N < 0.5 * STEP_N / np.sqrt(12.0)


def test_a_tone_taken_off_leaves_the_rounding_undone() -> None:
    one = unrounded(recorded(MOVING_N, STEP_N, NOISE_N))
    tone = np.cos(2.0 * np.pi * 50.0 * TIME_S)
    np.testing.assert_allclose(
        replace(one, reading_N=one.reading_N - tone).fitted_N(ALL), one.fitted_N(ALL) - tone, atol=1e-12
    )
