"""Readings that stand still with the noise of the electronics."""

import numpy as np
import pytest

from piezod.estimation.recordings.frozen import still_stretches
from tests.unit.diagnose.residuals import lagged, mixed_work, model_of, noise, series, time

SAMPLES = 20_000
TIME_s = time(SAMPLES)
U = mixed_work(TIME_s)
MODEL_N = model_of(U)
MOVING = int(np.argmax(np.diff(U) == 0.0)) - 1950


def still(true_N, noise_N=0.3, seed=3, colour=0.0):
    reading_N = true_N + noise_N * noise(true_N.size, colour, np.random.default_rng(seed))
    return still_stretches(series(TIME_s, U, reading_N, noise_N), MODEL_N)


@pytest.mark.parametrize("colour", [0.0, 0.7])
@pytest.mark.parametrize("samples", [60, 300, 1500])
def test_a_level_with_noise_from_which_the_reading_leaps_back_is_found(samples, colour):
    frozen_N = MODEL_N.copy()
    frozen_N[MOVING : MOVING + samples] = MODEL_N[MOVING]
    (first, end), *more = still(frozen_N, colour=colour)
    assert not more
    assert abs(first - MOVING) < 25
    assert abs(end - MOVING - samples) < 25


LOW, HIGH = np.percentile(MODEL_N, [30, 75])


@pytest.mark.parametrize(
    "true_N",
    [
        MODEL_N,
        lagged(MODEL_N, 0.05),
        np.maximum(MODEL_N, LOW),
        np.minimum(MODEL_N, HIGH),
        np.concatenate((np.full(40, MODEL_N[0]), MODEL_N[:-40])),
        np.concatenate((np.full(400, MODEL_N[0]), MODEL_N[:-400])),
        0.2 * MODEL_N,
        MODEL_N + 20.0 * (TIME_s > TIME_s[SAMPLES // 2]),
    ],
    ids=["as the model", "lag", "gap", "clamp", "delay", "long delay", "weak", "load step"],
)
def test_nothing_else_that_stands_still_is_a_frozen_reading(true_N):
    assert not any(still(true_N, seed=seed) for seed in range(5))


LEAPS_V = np.repeat([20.0, 90.0, 40.0, 100.0, 60.0, 30.0, 80.0, 50.0, 110.0, 70.0] * 4, 500)


def at_steps(true_N):
    reading_N = true_N + 0.3 * noise(true_N.size, 0.0, np.random.default_rng(8))
    return still_stretches(series(time(LEAPS_V.size), LEAPS_V, reading_N, 0.3), model_of(LEAPS_V))


def test_a_reading_that_misses_one_of_many_steps_is_frozen():
    model_N = model_of(LEAPS_V)
    true_N = model_N.copy()
    true_N[7400:7700] = model_N[7400]
    ((first, end),) = at_steps(true_N)
    assert abs(first - 7500) < 5
    assert abs(end - 7700) < 5


@pytest.mark.parametrize("late", [20, 60, 200])
def test_a_reading_that_is_late_at_every_step_is_not_frozen(late):
    model_N = model_of(LEAPS_V)
    assert at_steps(np.concatenate((np.full(late, model_N[0]), model_N[:-late]))) == []


RISING_V = np.repeat(np.arange(10.0, 160.0, 10.0), 500)  # equal steps: each looks like the end of a pause


@pytest.mark.parametrize("early", [1, 2, 5])
def test_a_reading_ahead_of_its_recorded_command_is_not_frozen(early):
    model_N = model_of(RISING_V)
    true_N = np.append(model_N[early:], np.full(early, model_N[-1]))
    reading_N = true_N + 0.3 * noise(true_N.size, 0.0, np.random.default_rng(8))
    assert not still_stretches(series(time(RISING_V.size), RISING_V, reading_N, 0.3), model_N)
