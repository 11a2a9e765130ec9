"""Wild cells, spikes and lost frames are found and named; pulses of the bench and steps of a converter are not."""

import numpy as np
import pytest

from piezod.estimation.recordings.intake import usable
from piezod.estimation.recordings.strays import without_strays
from piezod.recording import Recording
from tests.benches.plain_stack import NOISE_N, RATE_HZ, read, triangles

U = triangles([100, 40, 80, 60, 100, 30])
Y = read(U, 1)
ROWS = [700, 1234, 2001]


def strays_of(voltage_V, force_N):
    recording = Recording(np.arange(U.size) / RATE_HZ, {"voltage_V": voltage_V, "force_N": force_N})
    return without_strays(recording, "voltage_V", "force_N")


def but(values, rows, value):
    changed = values.copy()
    changed[rows] = value
    return changed


@pytest.mark.parametrize("value", [1e12, np.inf, -np.inf, 5000.0, -3.0e4, 9.97e36])
def test_one_wild_reading_is_named_and_left_out(value):
    recording, notes = strays_of(U, but(Y, 1234, value))
    assert len(notes) == 1
    assert f"row 1235 ({value:.6g} at 6.17 s)" in notes[0]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(recording.channel("force_N"))), [1234])


@pytest.mark.parametrize("value", [1e12, np.inf, 5000.0, -700.0])
def test_one_wild_command_is_named_and_interpolated(value):
    recording, notes = strays_of(but(U, 1234, value), Y)
    assert len(notes) == 1
    assert f"voltage_V: 1 sample, stray: row 1235 ({value:.6g} at 6.17 s)" in notes[0]
    np.testing.assert_allclose(recording.channel("voltage_V"), U, atol=0.01)
    assert not np.isnan(recording.channel("force_N")).any()


@pytest.mark.parametrize("value", [0.0, -1.0, 999.0])
def test_lost_frames_are_all_found_and_no_other_reading(value):
    lost = np.random.default_rng(5).random(U.size) < 0.008
    recording, notes = strays_of(U, but(Y + 300.0, lost, value))
    np.testing.assert_array_equal(np.isnan(recording.channel("force_N")), lost)
    assert len(notes) == 1
    assert f"{np.count_nonzero(lost)} samples, lost frames at {value:g}" in notes[0]


def test_many_readings_at_both_rails_are_lost():
    rng = np.random.default_rng(11)
    lost = rng.random(U.size) < 0.09
    at_rails = np.where(lost, np.where(rng.random(U.size) < 0.5, -400.0, 400.0), Y)
    recording, notes = strays_of(U, at_rails)
    np.testing.assert_array_equal(np.isnan(recording.channel("force_N")), lost)
    assert len(notes) == 2
    assert all(any(f"lost frames at {value:g}:" in note for note in notes) for value in (-400.0, 400.0))


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_readings_that_a_limit_clips_are_no_lost_frames(share):
    assert strays_of(U, np.clip(Y, *np.quantile(Y, [share, 1.0 - share])))[1] == []


def test_many_pulses_that_the_reading_answers_are_none():
    pulsed = but(U, np.arange(20, U.size, 12), 130.0)
    assert strays_of(pulsed, read(pulsed, 1))[1] == []


def test_a_longer_burst_at_a_lost_value_is_lost_too():
    lost = np.isin(np.arange(U.size), [*ROWS, *range(1500, 1530)])
    recording, _ = strays_of(U, but(Y + 300.0, lost, 0.0))
    np.testing.assert_array_equal(np.isnan(recording.channel("force_N")), lost)


def test_pulses_of_the_command_that_the_reading_answers_are_none():
    pulsed = but(U, ROWS, 95.0)
    assert strays_of(pulsed, read(pulsed, 1))[1] == []
    assert strays_of(pulsed, read(pulsed, 1, late=12))[1] == []


@pytest.mark.parametrize("step_N", [0.5, 4.0, 12.0])
def test_steps_of_a_coarse_converter_are_none(step_N):
    assert strays_of(U, step_N * np.round(Y / step_N))[1] == []


def test_noise_and_what_is_missing_already_are_none():
    noise_N = np.random.default_rng(3).standard_t(3, U.size)
    assert strays_of(U, but(Y + noise_N, ROWS, np.nan))[1] == []


def test_identification_gets_neither_wild_cells_nor_their_range():
    recording = Recording(np.arange(U.size) / RATE_HZ, {"voltage_V": but(U, 50, 1e12), "force_N": but(Y, 900, np.inf)})
    one = usable(recording, "voltage_V", "force_N", "")
    assert np.nanmax(one.recording.channel("force_N")) < 100.0
    assert np.max(one.recording.channel("voltage_V")) <= 100.0
    assert [note for note in one.notes if "row 51 (1e+12 at 0.25 s)" in note]
    assert [note for note in one.notes if "row 901 (inf at 4.5 s)" in note]


@pytest.mark.parametrize("noises", [40.0, 50.0, -60.0])
def test_small_spikes_far_above_the_noise_are_left_out(noises):
    slow_V = np.interp(np.arange(6 * U.size) / 6.0, np.arange(U.size), U)
    force_N, spikes = read(slow_V, 1), np.arange(60, slow_V.size - 60, 97)
    columns = {"voltage_V": slow_V, "force_N": but(force_N, spikes, force_N[spikes] + noises * NOISE_N)}
    recording, notes = without_strays(Recording(np.arange(slow_V.size) / RATE_HZ, columns), "voltage_V", "force_N")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(recording.channel("force_N"))), spikes)
    assert len(notes) == 1
