"""Spectrum and power map of a residual, against the noise floor."""

import numpy as np
import pytest

from piezod.report.diagnosis.residual.spectra import spectrum, time_frequency
from tests.unit.report.example_diagnosis import DT_S


def test_white_noise_of_the_floors_power_has_zero_decibels():
    noise = np.random.default_rng(3).normal(0.0, 0.2, 60_000)
    level_dB = time_frequency(noise, DT_S, 0.2).level_dB
    assert 10.0 * np.log10(np.mean(10.0 ** (level_dB / 10.0))) == pytest.approx(0.0, abs=0.3)
    frequency_Hz, density = spectrum(noise, DT_S)
    assert np.sqrt(np.trapezoid(density**2, frequency_Hz)) == pytest.approx(0.2, rel=0.03)


def test_a_tone_stands_out_at_its_time_and_frequency():
    time_s = np.arange(60_000) * DT_S
    tone = np.where((time_s > 30.0) & (time_s < 60.0), np.sin(2 * np.pi * 50.0 * time_s), 0.0)
    found = time_frequency(tone + np.random.default_rng(3).normal(0.0, 0.1, tone.size), DT_S, 0.1)
    row, column = np.unravel_index(found.level_dB.argmax(), found.level_dB.shape)
    assert found.frequency_Hz[row] <= 50.0 <= found.frequency_Hz[row + 1]
    assert 30.0 < found.time_s[column] < 60.0
