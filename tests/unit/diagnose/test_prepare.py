"""Recordings made ready: a clock that skips a tick, and samples that follow no clock."""

from pathlib import Path

import numpy as np
import pytest

from piezod.diagnose.prepare import Source, even, without_frozen
from piezod.errors import RecordingError
from piezod.model import load_model
from piezod.recording import Recording

RATE_Hz = 200.0


@pytest.fixture(scope="module")
def model():
    return load_model(Path(__file__).parents[3] / "config" / "model.yaml")


def a_recording(time_s, model):
    voltage_V = 50.0 + 40.0 * np.sin(2.0 * time_s)
    channels = {model.input.channel: voltage_V, model.output.channel: 1.5 * voltage_V}
    return Source(Recording(time_s, channels, {}, "some.csv"), "", "recording")


def test_where_a_tick_was_missed_the_voltage_stays_and_no_reading_counts(model):
    missed = [100, 400, 401, 402]
    time_s = np.delete(np.arange(2000) / RATE_Hz, missed)
    series, notes = even(a_recording(time_s, model), model)
    assert series.time_s.size == 2000
    assert np.flatnonzero(~series.counts).tolist() == missed
    assert series.command_V[100] == series.command_V[99]
    assert np.all(series.command_V[400:403] == series.command_V[399])
    whole = 50.0 + 40.0 * np.sin(2.0 * series.time_s)
    np.testing.assert_allclose(series.command_V[series.counts], whole[series.counts], rtol=1e-12)
    assert notes == ["some.csv: 4 of 2000 samples are missing; they do not count"]


def test_samples_that_follow_no_clock_are_resampled(model):
    time_s = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 2000)) / RATE_Hz
    series, notes = even(a_recording(time_s, model), model)
    steps_s = np.diff(series.time_s)
    np.testing.assert_allclose(steps_s, steps_s[0], rtol=1e-9)
    assert series.counts.all()
    assert "resampled" in notes[0]


def test_a_recording_whose_reading_never_moves_is_refused_in_one_line(model):
    source = a_recording(np.arange(2000) / RATE_Hz, model)
    source.recording.channels[model.output.channel][:] = 41.25
    series, _ = even(source, model)
    with pytest.raises(
        RecordingError, match=r"some\.csv: the reading stands still at 41\.25 N .* 9\.99 s; look at the sensor"
    ):
        without_frozen(series, model)
    source.recording.channels[model.output.channel][1500:] = 1.5 * source.recording.channels[model.input.channel][1500:]
    left, stretches = without_frozen(even(source, model)[0], model)
    assert stretches == [(0, 1500)]
    assert np.count_nonzero(left.counts) == 501
