"""Modes that ring in a residual: sharp ones and well damped ones."""

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from piezod.diagnose.candidates.direct import peaks_Hz
from tests.unit.diagnose.residuals import mixed_work, series, time

SAMPLES = 60_000
TIME_s = time(SAMPLES)


def ringing(frequency_Hz, damping, seed):
    omega = 2000.0 * np.tan(np.pi * frequency_Hz / 1000.0)  # so that it rings there in samples too
    b, a = bilinear([omega**2], [1.0, 2.0 * damping * omega, omega**2], 1000.0)
    knocks = np.random.default_rng(seed).standard_normal(SAMPLES)
    rung = lfilter(b, a, knocks)
    return rung / rung.std() + 0.1 * np.random.default_rng(seed + 100).standard_normal(SAMPLES)


@pytest.mark.parametrize("frequency_Hz", [30.0, 90.0, 210.0])
@pytest.mark.parametrize("damping", [0.005, 0.02, 0.05, 0.1])
def test_a_mode_is_seen_however_well_it_is_damped(frequency_Hz, damping):
    for seed in range(5):
        residual_N = ringing(frequency_Hz, damping, seed)
        one = series(TIME_s, mixed_work(TIME_s), residual_N)
        assert min(abs(f / frequency_Hz - 1.0) for f in peaks_Hz(one, residual_N)) < max(damping, 0.05)
