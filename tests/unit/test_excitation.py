"""Excitations and periods, from their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.excitation import EXCITATIONS, excitation, varying_triangles, whole_periods


@pytest.mark.parametrize("name", EXCITATIONS)
def test_an_excitation_starts_and_ends_at_zero_and_reaches_its_peak(name):
    voltages = excitation(name, 140.0, 0.1, 5, 100.0)
    assert voltages[0] == 0.0
    assert voltages[-1] == pytest.approx(0.0, abs=1e-9)
    assert voltages.max() == pytest.approx(140.0)
    assert voltages.min() >= 0.0


def test_the_peaks_of_varying_triangles_grow_and_shrink():
    voltages = varying_triangles(140.0, 0.1, 5, 100.0)
    peaks = [voltages[k * 1000 : (k + 1) * 1000].max() for k in range(5)]
    np.testing.assert_allclose(peaks, np.array([1, 2, 3, 2, 1]) * 140.0 / 3)


@given(st.floats(0.001, 200.0), st.sampled_from([50.0, 200.0, 1000.0, 3333.0]))
def test_whole_periods_fill_whole_ticks(frequency_Hz, rate_Hz):
    periods, ticks = whole_periods(frequency_Hz, rate_Hz)
    assert ticks / rate_Hz * frequency_Hz == pytest.approx(periods, rel=2e-3 / max(1.0, ticks / 1000.0))
