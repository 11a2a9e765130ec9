"""Excitations and periods, from their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.excitation import (
    EXCITATIONS,
    IDENTIFICATION,
    MINOR_LOOP_BIASES,
    MINOR_LOOP_SIZES,
    default_periods,
    duration_s,
    excitation,
    varying_triangles,
    whole_periods,
)
from piezod.operators import PrandtlIshlinskii


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


@pytest.mark.parametrize("name", EXCITATIONS)
def test_duration_s_is_the_length_of_the_excitation(name):
    voltages = excitation(name, 140.0, 0.1, 2, 100.0)
    assert (voltages.size - 1) / 100.0 == pytest.approx(duration_s(name, 0.1, 2), abs=0.01)


def test_triangles_are_repeated_five_times_and_the_identification_record_once():
    for name in EXCITATIONS:
        assert default_periods(name) == (1 if name == IDENTIFICATION else 5)


@given(st.floats(1.0, 1000.0), st.floats(0.01, 1.0), st.integers(1, 3))
def test_the_identification_record_stays_in_range_and_below_ten_times_the_triangles_slew(peak_V, frequency_Hz, periods):
    rate_Hz = 200.0 * frequency_Hz
    voltages = excitation(IDENTIFICATION, peak_V, frequency_Hz, periods, rate_Hz)
    assert voltages.min() >= 0.0
    assert voltages.max() <= peak_V
    slew_V_per_s = np.abs(np.diff(voltages)).max() * rate_Hz
    assert slew_V_per_s < 10.0 * 2.0 * peak_V * frequency_Hz


def test_the_identification_record_has_constant_sections_up_and_down():
    voltages = excitation(IDENTIFICATION, 140.0, 0.1, 1, 100.0)
    moves = np.flatnonzero(np.diff(voltages) != 0)
    gaps = np.flatnonzero(np.diff(moves) >= 90)  # a dwell of a tenth of ten seconds, sampled at 100 Hz
    before, after = moves[gaps], moves[gaps + 1]
    rising = np.diff(voltages)[before] > 0
    onward = np.diff(voltages)[after] > 0
    up = {round(level, 6) for level in voltages[after[rising & onward]]}
    down = {round(level, 6) for level in voltages[after[~rising & ~onward]]}
    levels = {round(140.0 * k / 8, 6) for k in range(1, 8)}
    assert up == levels
    assert down == levels


def test_the_identification_record_begins_with_the_virgin_rise_at_an_eighth_of_the_slew():
    voltages = excitation(IDENTIFICATION, 140.0, 0.1, 1, 100.0)
    rise = voltages[: np.argmax(voltages) + 1]
    assert np.diff(rise).min() >= 0.0
    assert np.diff(rise).max() * 100.0 == pytest.approx(2.0 * 140.0 * 0.1 / 8)


@pytest.mark.parametrize("bias", MINOR_LOOP_BIASES)
@pytest.mark.parametrize("size", MINOR_LOOP_SIZES)
def test_the_identification_record_runs_each_minor_loop_twice(bias, size):
    voltages = excitation(IDENTIFICATION, 1.0, 0.1, 1, 1000.0)
    moving = voltages[np.insert(np.diff(voltages) != 0, 0, True)]
    turns = moving[1:-1][np.diff(np.sign(np.diff(moving))) != 0]
    high, low = bias + size / 2, bias - size / 2
    found = np.abs(np.lib.stride_tricks.sliding_window_view(turns, 4) - [high, low, high, low]).max(axis=1)
    assert found.min() < 1e-3


def test_the_identification_record_determines_every_play_better_than_constant_triangles_of_equal_length():
    def spread(name, periods):
        """Standard deviations of play weights under white noise of the size of the peak."""
        voltages = excitation(name, 1.0, 0.1, periods, 20.0)
        columns = np.array([PrandtlIshlinskii((0.0, r), (0.5, 0.5)).run(voltages) for r in np.arange(1, 10) / 10])
        columns = np.vstack((voltages, 2.0 * columns - voltages))
        return np.sqrt(np.diag(np.linalg.inv(columns @ columns.T)))

    whole = duration_s(IDENTIFICATION, 0.1, 1)
    ratio = spread(IDENTIFICATION, 1) / spread("constant-triangles", round(whole / 10.0))
    assert ratio.max() < 1.0
    assert ratio[5:].max() < 0.5  # plays that steady triangles do not move


def test_the_identification_record_reverses_from_the_peak_at_four_depths_and_zero():
    voltages = excitation(IDENTIFICATION, 1.0, 0.1, 1, 1000.0)
    moving = voltages[np.insert(np.diff(voltages) != 0, 0, True)]
    turns = np.round(moving[1:-1][np.diff(np.sign(np.diff(moving))) != 0], 3)
    valleys = {turns[k] for k in range(1, turns.size - 1) if turns[k - 1] == turns[k + 1] == 1.0}
    assert {0.0, 0.2, 0.4, 0.6, 0.8} <= valleys


@given(st.floats(0.001, 200.0), st.sampled_from([50.0, 200.0, 1000.0, 3333.0]))
def test_whole_periods_fill_whole_ticks(frequency_Hz, rate_Hz):
    periods, ticks = whole_periods(frequency_Hz, rate_Hz)
    assert ticks / rate_Hz * frequency_Hz == pytest.approx(periods, rel=2e-3 / max(1.0, ticks / 1000.0))
