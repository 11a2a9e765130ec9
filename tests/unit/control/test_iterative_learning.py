"""Iterative learning on plants of a few lines: what repeats is removed, what does not is left, nothing diverges."""

import numpy as np
import pytest

from piezod.control.references.iterative_learning import Bounds, IterativeLearning, Learning

RATE_HZ, TICKS, NOISE = 500.0, 500, 0.1
REFERENCE = 150.0 + 100.0 * (2.0 * np.abs(2.0 * (np.arange(TICKS) / TICKS % 1.0) - 1.0) - 1.0)
FREE = np.zeros(TICKS, dtype=bool)
WIDE = Bounds(50.0)


def follow(plant, repeats, bounds=WIDE, seed=1, free=FREE):
    """Rms error of every repeat, the learning and the last correction; `plant` maps planned forces to readings."""
    random = np.random.default_rng(seed)
    learning = IterativeLearning(REFERENCE, REFERENCE, RATE_HZ, bounds)
    correction = np.zeros(TICKS)
    for repeat in range(repeats):
        force = plant(REFERENCE + correction, repeat) + random.normal(0.0, NOISE, TICKS)
        wanted = learning.add(force, correction, free)
        if wanted is not None:
            correction = wanted
    return np.array(learning.errors_N), learning, correction


def missed(amplitude=5.0):
    """A repeating error that turns with the direction within 20 ms, as friction leaves it."""
    way = np.sign(np.roll(REFERENCE, -1) - REFERENCE)
    turning = np.fft.irfft(np.fft.rfft(way) * np.exp(-0.5 * (np.arange(TICKS // 2 + 1) / 16.0) ** 2), TICKS)
    return amplitude * turning + 0.02 * (REFERENCE - 150.0)


def test_a_repeating_error_is_gone_to_the_noise_by_the_fifth_repeat():
    errors, _, _ = follow(lambda planned, _: planned + missed(), 8)
    assert errors[0] > 40 * NOISE
    assert errors[4:].max() < 2.0 * NOISE
    assert errors[6:].max() < 1.25 * NOISE


@pytest.mark.parametrize("ticks", [1, 3, 7])
def test_learning_compensates_a_delay_of_whole_ticks(ticks):
    errors, _, _ = follow(lambda planned, _: np.roll(planned, ticks), 8)
    assert errors[0] > 7 * NOISE
    assert errors[-1] < 1.3 * NOISE


def test_a_first_order_lag_of_8_ms_is_led():
    omega = 2.0 * np.pi * np.fft.rfftfreq(TICKS, 1.0 / RATE_HZ)

    def lag(planned, _):
        return np.fft.irfft(np.fft.rfft(planned) / (1.0 + 0.008j * omega), TICKS)

    errors, _, _ = follow(lag, 8)
    assert errors[-1] < 1.6 * NOISE


def test_with_nothing_to_learn_noise_is_not_learned():
    errors, _, correction = follow(lambda planned, _: planned, 12)
    assert errors[4:].mean() < 1.05 * NOISE
    assert np.sqrt(np.mean(correction**2)) < 0.35 * NOISE


def test_a_tone_of_its_own_frequency_is_not_learned():
    time = np.arange(TICKS) / RATE_HZ

    def tone(planned, repeat):
        return planned + 1.5 * np.sin(2.0 * np.pi * 17.3 * (time + repeat * TICKS / RATE_HZ))

    errors, _, correction = follow(tone, 12)
    assert np.sqrt(np.mean(correction**2)) < 0.3
    assert errors[4:].max() < 1.15 * errors[0]


@pytest.mark.parametrize("frequency_Hz", [50.0, 60.0])
def test_hum_of_the_mains_is_not_learned_though_it_repeats(frequency_Hz):
    hum = np.sin(2.0 * np.pi * frequency_Hz * np.arange(TICKS) / RATE_HZ)
    _, _, correction = follow(lambda planned, _: planned + hum, 8)
    assert abs(np.vdot(correction, hum)) / np.vdot(hum, hum) < 0.02


def test_a_step_of_the_load_between_two_repeats_is_learned_in_two():
    errors, learning, _ = follow(lambda planned, repeat: planned + missed() + (8.0 if repeat >= 8 else 0.0), 12)
    assert errors[8] > 20 * NOISE
    assert errors[10:].max() < 3.0 * NOISE
    assert learning.state is Learning.LEARNING


def test_a_drift_is_followed_closer_than_its_change_a_repeat():
    errors, _, _ = follow(lambda planned, repeat: planned + 1.0 * repeat, 12)
    assert errors[5:].max() < 0.5


@pytest.mark.parametrize("gain", [0.3, 2.5, 3.0])
def test_the_answer_to_a_correction_tells_how_strong_it_must_be(gain):
    errors, learning, _ = follow(lambda planned, _: REFERENCE + missed() + gain * (planned - REFERENCE), 12)
    assert learning.state is Learning.LEARNING
    assert errors[-4:].max() < 0.05 * errors[0]


def test_a_bench_that_answers_the_wrong_way_stops_learning_at_the_best():
    errors, learning, correction = follow(lambda planned, _: REFERENCE + missed() - (planned - REFERENCE), 20)
    assert learning.state is Learning.STOPPED
    assert errors[-1] < 1.05 * errors[0]
    assert np.abs(correction).max() <= 50.0


def test_a_correction_stays_within_its_bounds():
    bounds = Bounds(3.0, 60.0, 252.0)
    _, _, correction = follow(lambda planned, _: planned + missed(), 6, bounds)
    assert np.abs(correction).max() <= 3.0
    assert (REFERENCE + correction).max() <= 252.0
    assert (REFERENCE + correction).min() >= min(60.0, REFERENCE.min())


def test_ticks_at_a_limit_teach_nothing():
    limited = REFERENCE > 200.0
    _, _, correction = follow(lambda planned, _: np.minimum(planned, 200.0) + 0.0 * planned, 8, free=limited)
    assert np.abs(correction[~limited]).max() < 1.0
    assert np.abs(correction).max() < 1.0


def test_a_repeat_of_few_ticks_is_learned_too():
    reference = 100.0 + 50.0 * np.sin(2.0 * np.pi * np.arange(20) / 20)
    learning = IterativeLearning(reference, reference, 200.0, Bounds(20.0))
    correction = np.zeros(20)
    for _ in range(6):
        wanted = learning.add(1.05 * (reference + correction) - 2.0, correction, np.zeros(20, dtype=bool))
        correction = correction if wanted is None else wanted
    assert learning.errors_N[-1] < 0.05 * learning.errors_N[0]


def test_a_year_of_repeats_needs_no_more_memory_than_a_few():
    learning = IterativeLearning(REFERENCE, REFERENCE, RATE_HZ, WIDE)
    force = REFERENCE + 1.0
    for _ in range(300):
        learning.add(force, np.zeros(TICKS), FREE)
    assert learning.repeats == 300
    assert learning.first_N == pytest.approx(1.0)
    assert len(learning.errors_N) == 100


@pytest.mark.parametrize("ticks", [1, 2, 3, 5])
def test_the_shortest_tables_are_learned_without_an_error(ticks):
    reference = 100.0 + np.arange(ticks, dtype=float)
    learning, correction = IterativeLearning(reference, reference, 50.0, WIDE), np.zeros(ticks)
    for _ in range(6):
        wanted = learning.add(reference + correction - 2.0, correction, np.zeros(ticks, dtype=bool))
        correction = correction if wanted is None else wanted
    assert np.isfinite(correction).all()
    assert learning.errors_N[-1] <= learning.first_N


@pytest.mark.parametrize("frequency_Hz", [9.0, 22.0, 37.0, 61.0, 83.0])
@pytest.mark.parametrize("damping", [0.01, 0.03, 0.1])
def test_a_lightly_damped_mode_is_not_driven_up(frequency_Hz, damping):
    """A stack under a load: the response is ten to fifty times that of a delay at the mode, and turns there."""
    ratio = np.fft.rfftfreq(TICKS, 1.0 / RATE_HZ) / frequency_Hz
    mode = 1.0 / (1.0 - ratio**2 + 2.0j * damping * ratio)

    def plant(planned, _):
        return np.fft.irfft(np.fft.rfft(planned + missed(1.0)) * mode, TICKS)

    errors, _, _ = follow(plant, 40)
    assert errors[2:].max() < 12.0 * errors[0]
    assert errors[-10:].max() < 1.3 * errors[0]
