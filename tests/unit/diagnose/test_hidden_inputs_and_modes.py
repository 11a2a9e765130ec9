"""Benches whose reading follows the drive through several modes, or an input that nobody recorded."""

import numpy as np
import pytest

import piezod
from piezod.recording import Recording
from piezod.report.identification import identification_as_dict


def modal(seed):
    """Two exact periods of a multisine from 1 to 60 Hz through modes at 7.2, 9.2 and 37.5 Hz, with noise of 0.03 N."""
    rate_Hz, samples = 500.0, 5000
    frequencies_Hz = np.fft.rfftfreq(samples, 1.0 / rate_Hz)
    band = (frequencies_Hz >= 1.0) & (frequencies_Hz <= 60.0)
    lines = np.where(band, np.exp(2j * np.pi * np.random.default_rng(3).uniform(size=band.size)), 0.0)
    command_V = np.fft.irfft(lines, samples)
    response = sum(
        gain * mode_Hz**2 / (mode_Hz**2 - frequencies_Hz**2 + 0.04j * mode_Hz * frequencies_Hz)
        for mode_Hz, gain in ((7.2, 1.0), (9.2, 0.5), (37.5, 0.3))
    )
    size = 5.0 / np.abs(command_V).max()
    force_N = size * np.tile(np.fft.irfft(lines * response, samples), 2)
    force_N += 0.03 * np.random.default_rng(seed).normal(size=force_N.size)
    channels = {"voltage_V": size * np.tile(command_V, 2), "force_N": force_N}
    return Recording(np.arange(2 * samples) / rate_Hz, channels, {}, f"modal{seed}.csv")


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


def behind_plays(frequencies):
    """Periodic readings of two plays before parallel modes (frequency, gain) with a damping of 0.03."""
    rate_Hz, samples = 500.0, 4000
    lines_Hz = np.fft.rfftfreq(samples, 1.0 / rate_Hz)
    band = (lines_Hz >= 0.5) & (lines_Hz <= 60.0)
    lines = np.where(band, np.exp(2j * np.pi * np.random.default_rng(11).uniform(size=band.size)), 0.0)
    command_V = np.fft.irfft(lines, samples)
    command_V = np.tile(50.0 + 40.0 * command_V / np.abs(command_V).max(), 3)
    stroke_N = 0.6 * command_V
    for threshold_V in (5.0, 15.0):
        play = command_V[0]
        for k, value in enumerate(command_V):
            play = min(max(play, value - threshold_V), value + threshold_V)
            stroke_N[k] += 0.2 * play
    at_Hz = np.fft.rfftfreq(2 * samples, 1.0 / rate_Hz)
    response = sum(gain * f**2 / (f**2 - at_Hz**2 + 0.06j * f * at_Hz) for f, gain in frequencies)
    force_N = np.fft.irfft(np.fft.rfft(stroke_N[samples:]) * response, 2 * samples)
    force_N += 0.05 * np.random.default_rng(1).normal(size=force_N.size)
    channels = {"voltage_V": command_V[samples:], "force_N": force_N}
    return Recording(np.arange(force_N.size) / rate_Hz, channels, {}, "behind_plays.csv")


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
