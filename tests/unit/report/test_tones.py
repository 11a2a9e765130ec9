"""Tones in a spectrum: sines of known amplitude are found, noise and humps are none."""

import numpy as np
import pytest

from piezod.report.diagnosis.residual.spectra import spectrum, windows_of
from piezod.report.dynamics import find_tones

DT_S, SAMPLES = 0.005, 40_000
TIME_S = DT_S * np.arange(SAMPLES)


def tones_of(residual, command):
    frequency_Hz, density = spectrum(residual, DT_S)
    return find_tones(frequency_Hz, density, spectrum(command, DT_S)[1], windows_of(residual.size))


def sine(frequency_Hz, amplitude):
    return amplitude * np.sin(2.0 * np.pi * frequency_Hz * TIME_S + 0.4)


@pytest.mark.parametrize("frequency_Hz", [50.0, 49.97, 17.3])
def test_a_hum_has_its_frequency_and_amplitude(frequency_Hz):
    noise = 0.05 * np.random.default_rng(1).standard_normal(SAMPLES)
    found = tones_of(noise + sine(frequency_Hz, 0.02), sine(0.1, 60.0))
    assert [tone.in_input for tone in found] == [False]
    assert found[0].frequency_Hz == pytest.approx(frequency_Hz, abs=0.03)  # half a bin of 0.049 Hz
    assert found[0].amplitude == pytest.approx(0.02, rel=0.1)


def test_a_line_that_the_input_has_is_told_from_one_that_it_has_not():
    noise = 0.05 * np.random.default_rng(2).standard_normal(SAMPLES)
    found = tones_of(noise + sine(12.5, 0.05) + sine(31.0, 0.03), sine(12.5, 60.0))
    assert [(round(tone.frequency_Hz, 1), tone.in_input) for tone in found] == [(12.5, True), (31.0, False)]


def test_noise_has_a_tone_in_few_of_a_hundred_spectra():
    source = np.random.default_rng(3)
    wrong = sum(len(tones_of(source.standard_normal(SAMPLES), sine(0.1, 60.0))) > 0 for _ in range(100))
    assert wrong <= 5  # expected: 1; 6 or more have a probability of 0.0005


def test_a_hump_is_no_tone():
    white = np.random.default_rng(4).standard_normal(SAMPLES)
    spectrum_of = np.fft.rfft(white)
    frequency_Hz = np.fft.rfftfreq(SAMPLES, DT_S)
    hump = np.fft.irfft(spectrum_of * (1.0 + 5.0 * np.exp(-(((frequency_Hz - 20.0) / 0.4) ** 2))), SAMPLES)
    assert tones_of(hump, sine(0.1, 60.0)) == []
