"""Noise from repeats and rests, whatever a model leaves."""

import numpy as np
import pytest

from piezod.estimation.recordings.noise import COARSE, _period, noise_of, noise_of_input, rests

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


def multisine(rng, periods, ratio=1.0):
    """Exact periods of sines of 1 to 60 Hz with random phases, and their driven part of the next one [V]."""
    period = np.arange(round(2000 * ratio)) / RATE_HZ
    lines = np.arange(4, 240) / (period.size / RATE_HZ)
    one = sum(np.cos(2 * np.pi * (line * period + rng.uniform())) for line in lines)
    return np.resize(50.0 + 2.0 * one, round(periods * period.size))


def ringing(u):
    """A mode of 7 Hz, hardly damped, behind a play: it remembers its start for seconds [N]."""
    play, spring, out = 0.0, np.zeros(2), np.empty(u.size)
    for k, now in enumerate(u):
        play = min(max(play, now - 5.0), now + 5.0)
        spring[1] += (44.0**2 * (0.1 * play - spring[0]) - 2.0 * spring[1]) / RATE_HZ
        spring[0] += spring[1] / RATE_HZ
        out[k] = 0.6 * now + 0.2 * play + spring[0]
    return out


@pytest.mark.parametrize("noise_N", [0.03, 1.0])
@pytest.mark.parametrize("periods", [2.0, 2.5, 7.0])
def test_two_exact_periods_tell_the_noise_though_modes_ring(periods, noise_N):
    u = multisine(np.random.default_rng(2), periods)
    y = ringing(np.concatenate((np.resize(u[:2000], 10_000), u)))[10_000:]
    noise = found(u, noise_N, y)
    assert noise.seen_in == "repeats"
    assert noise.rms == pytest.approx(noise_N, rel=0.1)


def test_a_period_is_found_in_a_long_recording_to_the_sample():
    u = multisine(np.random.default_rng(4), 2.0, ratio=150.0037)
    assert u.size > 2 * COARSE
    assert _period(u) == u.size // 2


def test_a_course_that_nearly_comes_again_tells_none_though_the_output_is_only_a_remainder():
    peaks = np.array([0, 100, 0, 40, 0, 80, 0, 60, 0, 100, 0, 30, 0], dtype=float)
    u = np.interp(np.arange(2400), np.linspace(0, 2399, peaks.size), peaks)
    assert found(u, 0.05, 0.0 * u) is None


def test_a_measured_voltage_has_noise_of_its_own_and_repeats_still():
    rng = np.random.default_rng(5)
    u = multisine(rng, 2.0)
    assert found(u + 0.01 * rng.normal(size=u.size), 0.5, 0.6 * u).rms == pytest.approx(0.5, rel=0.1)


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
        np.interp(TIME_S, np.arange(40), np.random.default_rng(4).uniform(0.0, 100.0, 40)),
        multisine(np.random.default_rng(6), 1.0, ratio=10.0),
        100.0 * TIME_S / TIME_S[-1],
    ],
    ids=["growing", "chirp", "random", "ramps", "one period", "one ramp"],
)
def test_an_input_that_neither_repeats_nor_rests_tells_none(u):
    assert found(u, 0.3) is None


def test_jumps_that_do_not_repeat_are_no_noise():
    y = 2.0 * TRIANGLES
    for first, height in ((3000, 80.0), (11_000, -120.0), (16_500, 60.0)):
        y[first : first + 200] += height
    assert found(TRIANGLES, 0.3, y).rms == pytest.approx(0.3, rel=0.15)


@pytest.mark.parametrize("monitor_V", [0.02, 0.2])
def test_a_measured_command_rests_within_its_own_noise(monitor_V):
    rng = np.random.default_rng(3)
    everywhere = np.ones(RESTS.size, bool)
    slow = np.resize(TRIANGLES, RESTS.size)
    for u, least in (
        (RESTS + monitor_V * rng.normal(size=RESTS.size), 60),
        (slow + 0.02 * rng.normal(size=slow.size), 0),
    ):
        assert len(rests(u, everywhere, 1.0 / RATE_HZ)) in range(least, least + 21)
    measured = RESTS + monitor_V * rng.normal(size=RESTS.size)
    assert noise_of_input(measured, everywhere, 1.0 / RATE_HZ) == pytest.approx(monitor_V, rel=0.05)
    assert noise_of_input(RESTS, everywhere, 1.0 / RATE_HZ) == 0.0
    assert noise_of_input(slow, everywhere, 1.0 / RATE_HZ) is None
    assert noise_of(measured, 2.0 * measured, everywhere, 1.0 / RATE_HZ).rms == pytest.approx(2.0 * monitor_V, rel=0.05)
