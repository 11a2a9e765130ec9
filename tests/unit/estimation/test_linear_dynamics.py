"""Linear dynamics are found from a broadband drive, and simulated as an unnamed law."""

import numpy as np
import pytest

from piezod.estimation.fit.linear_dynamics import fit_linear_dynamics
from piezod.estimation.fit.pole_starts import Driven
from piezod.model.unnamed_law import Axis, LawStep, Mode, UnnamedLaw

DT_S, SAMPLES = 0.002, 5000
FREQUENCIES_HZ = np.fft.rfftfreq(SAMPLES, DT_S)


def response(modes, lags, at_Hz):
    """Frequency response of parallel modes (frequency, damping, gain) and lags (time constant, gain)."""
    s = 2j * np.pi * at_Hz
    total = np.zeros(at_Hz.size, complex)
    for frequency_Hz, damping, gain in modes:
        natural = 2.0 * np.pi * frequency_Hz
        total += gain * natural**2 / (s**2 + 2.0 * damping * natural * s + natural**2)
    for time_constant_s, gain in lags:
        total += gain / (1.0 + s * time_constant_s)
    return total


def multisine(modes, lags, noise, seed, *, low_Hz=0.5, high_Hz=60.0):
    """Two periods of a multisine and its steady response with noise."""
    draw = np.random.default_rng(seed)
    lines = np.zeros(FREQUENCIES_HZ.size, complex)
    band = (low_Hz <= FREQUENCIES_HZ) & (high_Hz >= FREQUENCIES_HZ)
    lines[band] = np.exp(2j * np.pi * draw.uniform(size=band.sum()))
    command = np.fft.irfft(lines, SAMPLES)
    size = 5.0 / np.abs(command).max()
    reading = np.fft.irfft(lines * response(modes, lags, FREQUENCIES_HZ), SAMPLES)
    command, reading = (np.tile(size * one, 2) for one in (command, reading))
    return command, reading + noise * draw.normal(size=reading.size)


MODES = ((7.2, 0.02, 1.0), (9.2, 0.02, 0.5), (37.5, 0.02, 0.3))


def found(modes, lags, noise=0.03, seed=0):
    command, reading = multisine(modes, lags, noise, seed)
    return fit_linear_dynamics([Driven(command, reading, np.ones(command.size, bool), DT_S, noise)]), command, reading


@pytest.mark.parametrize("seed", range(3))
def test_three_modes_are_found_to_the_noise_although_the_record_begins_amid_motion(seed):
    dynamics, command, _ = found(MODES, (), seed=seed)
    poles = sorted(dynamics.poles, key=abs)
    np.testing.assert_allclose([abs(one) / 2.0 / np.pi for one in poles], [7.2, 9.2, 37.5], rtol=2e-3)
    np.testing.assert_allclose([-one.real / abs(one) for one in poles], 0.02, rtol=0.03)
    assert np.sqrt(dynamics.errors.sum() / command.size) == pytest.approx(1.0, abs=0.05), "left-out error over noise"


def test_a_slow_lag_is_no_mode():
    dynamics, *_ = found((), ((0.4, 2.0),))
    np.testing.assert_allclose(dynamics.poles, [-2.5], rtol=0.02)
    assert dynamics.gains[0] == pytest.approx(2.0, rel=0.02)


def test_noise_has_no_dynamics():
    draw = np.random.default_rng(1)
    command, noise = multisine(MODES, (), 0.0, 1)[0], draw.normal(size=2 * SAMPLES)
    dynamics = fit_linear_dynamics([Driven(command, noise, np.ones(command.size, bool), DT_S, 1.0)])
    assert dynamics is None or dynamics.explained < 0.01


def test_missing_readings_do_not_count():
    command, reading = multisine(MODES, (), 0.03, 2)
    counts = np.ones(command.size, bool)
    counts[3000:3400] = False
    spoilt = np.where(counts, reading, 1e3)
    dynamics = fit_linear_dynamics([Driven(command, spoilt, counts, DT_S, 0.03)])
    np.testing.assert_allclose(sorted(abs(dynamics.poles) / 2.0 / np.pi), [7.2, 9.2, 37.5], rtol=5e-3)


def test_the_law_predicts_another_drive_from_rest():
    dynamics, *_ = found(MODES, ((0.4, 2.0),))
    other, wanted = multisine(MODES, ((0.4, 2.0),), 0.0, 9)
    law = dynamics.as_law("command", [np.array([-6.0, 6.0])], DT_S)
    added = LawStep(law, DT_S).run(other, other)
    error = (added - wanted)[SAMPLES:]  # the start from rest has died out in the second period
    assert np.std(error) < 0.02 * np.std(wanted)
    told, true = law.response(FREQUENCIES_HZ[5:200], DT_S), response(MODES, ((0.4, 2.0),), FREQUENCIES_HZ[5:200])
    np.testing.assert_allclose(told, true, rtol=0.02, atol=0.02)


def test_a_mode_is_a_lag_with_a_complex_pole():
    mode = Mode(frequency_Hz=12.0, damping_ratio=0.1, real=(-1.0, 3.0), imaginary=(0.5, -2.0))
    law = UnnamedLaw(
        drivers=(Axis(driver="command", low=0.0, high=10.0, nodes=2),),
        dead_band=1e-6,
        smoothing_s=DT_S,
        memories_s=(0.0,),
        tables=((0.0, 0.0),),
        modes=(mode,),
    )
    command = 5.0 + 4.0 * np.sin(np.arange(400) / 7.0)
    keep = np.exp(2.0 * np.pi * 12.0 * (-0.1 + 1j * np.sqrt(0.99)) * DT_S)
    inputs = (-1.0 + 0.4 * command) + 1j * (0.5 - 0.25 * command)
    state, expected = inputs[0], np.empty(command.size)
    for k, one in enumerate(inputs):
        state = keep * state + (1.0 - keep) * one
        expected[k] = state.real
    np.testing.assert_allclose(LawStep(law, DT_S).run(command, command), expected, atol=1e-12)
    decays = law.decays(np.arange(400) * DT_S)
    np.testing.assert_allclose(decays[:, 0] + 1j * decays[:, 1], keep ** np.arange(400), atol=1e-9)
