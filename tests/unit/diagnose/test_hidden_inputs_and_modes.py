"""Benches whose reading follows the drive through several modes, or an input that nobody recorded."""

import numpy as np
import pytest

import piezod
from piezod.recording import Recording
from piezod.report.identification import identification_as_dict

RATE_HZ = 500.0


def multisine(samples, low_Hz, high_Hz, seed):
    """A period of a multisine with a peak of 1."""
    frequencies_Hz = np.fft.rfftfreq(samples, 1.0 / RATE_HZ)
    band = (frequencies_Hz >= low_Hz) & (frequencies_Hz <= high_Hz)
    lines = np.where(band, np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=band.size)), 0.0)
    period = np.fft.irfft(lines, samples)
    return period / np.abs(period).max()


def through(modes, signal, damping_ratio):
    """A periodic signal through parallel modes (frequency, gain)."""
    at_Hz = np.fft.rfftfreq(signal.size, 1.0 / RATE_HZ)
    response = sum(gain * f**2 / (f**2 - at_Hz**2 + 2j * damping_ratio * f * at_Hz) for f, gain in modes)
    return np.fft.irfft(np.fft.rfft(signal) * response, signal.size)


def modal(seed):
    """Two exact periods of a multisine from 1 to 60 Hz through modes at 7.2, 9.2 and 37.5 Hz, with noise of 0.03 N."""
    command_V = np.tile(5.0 * multisine(5000, 1.0, 60.0, 3), 2)
    force_N = through(((7.2, 1.0), (9.2, 0.5), (37.5, 0.3)), command_V, 0.02)
    force_N += 0.03 * np.random.default_rng(seed).normal(size=force_N.size)
    channels = {"voltage_V": command_V, "force_N": force_N}
    return Recording(np.arange(force_N.size) / RATE_HZ, channels, {}, f"modal{seed}.csv")


def damped(seed):
    """A damper whose coil current somebody changes every 0.1 s, with noise of 2 N."""
    draw = np.random.default_rng(seed)
    time_s = np.arange(12000) / 200.0
    velocity = 20.0 * np.sin(2.0 * np.pi * time_s) + 8.0 * np.sin(5.4 * np.pi * time_s)
    current = np.repeat(draw.uniform(size=600), 20)
    force_N = (200.0 + 500.0 * current) * np.tanh(velocity / 15.0) + 2.0 * draw.normal(size=time_s.size)
    return Recording(time_s, {"velocity_mm_s": velocity, "force_N": force_N}, {}, f"damped{seed}.csv")


@pytest.fixture(scope="module")
def modal_model():
    return piezod.identify(modal(1))


def test_modes_beside_the_hysteresis_are_identified(modal_model):
    law = modal_model.model.unnamed_law
    modes = sorted((mode.frequency_Hz, mode.damping_ratio) for mode in law.modes)
    np.testing.assert_allclose([frequency_Hz for frequency_Hz, _ in modes], [7.2, 9.2, 37.5], rtol=2e-3)
    np.testing.assert_allclose([ratio for _, ratio in modes], 0.02, rtol=0.05)
    assert modal_model.useful
    told = identification_as_dict(modal_model.identification)["linear_dynamics"]
    assert sorted(mode["frequency_Hz"] for mode in told["modes"]) == [frequency_Hz for frequency_Hz, _ in modes]
    assert told["lags_s"] == []
    assert modal_model.model.provenance.fit.rms_held_out == pytest.approx(0.03, rel=0.05), "the noise"


def test_its_own_model_explains_another_record_of_the_bench(modal_model):
    """Simulation of an untouched bench leaves the noise, and the diagnosis says the same."""
    simulated = piezod.simulate(modal(2), modal_model.model)
    left_N = (modal(2).channels["force_N"] - simulated.channels["force_N"])[500:]
    assert np.std(left_N) == pytest.approx(0.03, rel=0.05)
    assert piezod.diagnose(modal(2), modal_model.model).verdict == "matches"


def behind_plays(modes):
    """Periodic readings of two plays before parallel modes (frequency, gain) with a damping of 0.03."""
    samples = 4000
    command_V = 50.0 + 40.0 * np.tile(multisine(samples, 0.5, 60.0, 11), 3)
    stroke_N = 0.6 * command_V
    for threshold_V in (5.0, 15.0):
        play = command_V[0]
        for k, value in enumerate(command_V):
            play = min(max(play, value - threshold_V), value + threshold_V)
            stroke_N[k] += 0.2 * play
    force_N = through(modes, stroke_N[samples:], 0.03)
    force_N += 0.05 * np.random.default_rng(1).normal(size=force_N.size)
    channels = {"voltage_V": command_V[samples:], "force_N": force_N}
    return Recording(np.arange(force_N.size) / RATE_HZ, channels, {}, "behind_plays.csv")


def test_modes_behind_the_hysteresis_are_identified():
    found = piezod.identify(behind_plays(((7.2, 0.6), (9.2, 0.3), (37.5, 0.1))))
    law = found.model.unnamed_law
    np.testing.assert_allclose(sorted(mode.frequency_Hz for mode in law.modes), [7.2, 9.2, 37.5], rtol=5e-3)
    np.testing.assert_allclose([mode.damping_ratio for mode in law.modes], 0.03, rtol=0.15)
    assert found.identification.explained > 0.98


def test_a_single_mode_is_left_to_the_diagnosis_which_has_a_name_for_it():
    found = piezod.identify(behind_plays(((8.0, 1.0),)))
    assert not found.useful
    assert found.model.unnamed_law is None


def test_an_input_that_changes_the_gain_is_not_taken_for_noise():
    """Repeats of the velocity differ, as with noise, but each value holds for 0.1 s and grows with the force."""
    given = piezod.identify(damped(1), input="velocity_mm_s", output="force_N").model
    result = piezod.diagnose(damped(2), given)
    assert result.verdict == "unexplained"
    findings = result.diagnosis.findings
    assert findings.unrecorded.size == pytest.approx(500.0 / np.sqrt(12.0) / 450.0, rel=0.1)
    assert findings.unrecorded.keeps_s == pytest.approx(0.1, rel=0.2)
    assert not findings.noise_is_known
    assert findings.floor == pytest.approx(2.0, rel=0.25)
