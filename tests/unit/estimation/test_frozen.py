"""Readings that stand still: proof where the model moves, or where noise never lets one come twice."""

import numpy as np
import pytest

from piezod.estimation.recordings.frozen import frozen_stretches
from tests.unit.diagnose.residuals import lagged, mixed_work, model_of, noise, series, time

SAMPLES = 20_000
TIME_s = time(SAMPLES)
U = mixed_work(TIME_s)
HOLD = int(np.argmax(np.diff(U) == 0.0)) + 50
MOVING = HOLD - 2000


def found(reading_N, noise_N=0.5):
    return frozen_stretches(series(TIME_s, U, reading_N, noise_N), model_of(U))


def frozen(reading_N, first, samples):
    result = reading_N.copy()
    result[first : first + samples] = result[first]
    return result


def noisy(seed=1, step_N=0.0):
    reading_N = model_of(U) + 0.5 * noise(SAMPLES, 0.0, np.random.default_rng(seed))
    return reading_N if step_N == 0.0 else step_N * np.round(reading_N / step_N)


@pytest.mark.parametrize("first", [HOLD, MOVING])
@pytest.mark.parametrize("step_N", [0.0, 0.01])
def test_a_noisy_reading_that_stands_still_is_seen_also_while_the_command_rests(first, step_N):
    assert found(frozen(noisy(step_N=step_N), first, 20)) == [(first, first + 20)]


@pytest.mark.parametrize("step_N", [0.0, 0.01, 0.3, 2.0])
def test_noise_is_no_frozen_reading(step_N):
    assert not any(found(noisy(seed, step_N)) for seed in range(20))


def test_a_reading_without_noise_may_stand_still_while_the_command_rests():
    reading_N = model_of(U)
    assert np.mean(np.diff(reading_N) == 0.0) > 0.1
    assert found(reading_N, 0.01) == []


def test_a_bench_that_reads_the_same_whenever_it_rests_is_not_frozen_there():
    rests = np.concatenate(([False], np.diff(U) == 0.0))
    reading_N = np.where(rests, model_of(U), noisy())
    assert found(reading_N) == []


def test_a_reading_that_never_changes_is_one_stretch():
    with np.errstate(all="raise"):
        assert found(np.zeros(SAMPLES)) == [(0, SAMPLES)]


@pytest.mark.parametrize("step_N", [1.0, 2.0, 4.0, 6.0, 10.0])
@pytest.mark.parametrize("lag_s", [0.05, 0.1, 0.3, 2.0, 5.0])
def test_a_slow_reading_on_a_coarse_lattice_is_not_frozen(step_N, lag_s):
    slow_N = lagged(model_of(U), lag_s)
    assert found(step_N * np.round(slow_N / step_N), 1e-3) == []


@pytest.mark.parametrize("step_N", [2.0, 4.0])
def test_a_frozen_reading_is_seen_on_a_coarse_lattice(step_N):
    first, samples = MOVING, 3000
    reading_N = frozen(step_N * np.round(model_of(U) / step_N), first, samples)
    (begins, ends), *more = found(reading_N, 1e-3)
    assert begins <= first + 1
    assert ends >= first + samples
    assert not more


@pytest.mark.parametrize("late", [2, 10, 50])
def test_a_late_reading_of_a_command_that_leaps_is_not_frozen(late):
    leaps_V = np.concatenate((U, np.repeat([20.0, 90.0, 40.0, 100.0, 60.0] * 4, 500)))
    force_N = np.concatenate((np.full(late, model_of(U[0])), model_of(leaps_V)))[: leaps_V.size]
    reading_N = 4.0 * np.round(force_N / 4.0)
    assert frozen_stretches(series(time(leaps_V.size), leaps_V, reading_N, 1e-3), model_of(leaps_V)) == []
