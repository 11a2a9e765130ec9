"""Recordings made ready: a clock that skips a tick, and samples that follow no clock."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezod.diagnose.candidates.starts import recorded_channels
from piezod.diagnose.hypothesis.basis import PlayDensity
from piezod.diagnose.prepare import chain_of, substitute_recording
from piezod.errors import RecordingError
from piezod.estimation.recordings import preparation
from piezod.estimation.recordings.preparation import (
    FEWEST_SAMPLES,
    evenly_spaced,
    with_start,
    with_unknown_start,
    without_frozen,
)
from piezod.estimation.recordings.sources import Source
from piezod.estimation.recordings.unknown_past import fitted_past
from piezod.model import load_model
from piezod.recording import Recording
from tests.unit.diagnose.residuals import mixed_work, series, time

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
    series = evenly_spaced(a_recording(time_s, model), model)
    assert series.time_s.size == 2000
    assert np.flatnonzero(~series.counts).tolist() == missed
    assert series.command_V[100] == series.command_V[99]
    assert np.all(series.command_V[400:403] == series.command_V[399])
    whole = 50.0 + 40.0 * np.sin(2.0 * series.time_s)
    np.testing.assert_allclose(series.command_V[series.counts], whole[series.counts], rtol=1e-12)
    assert series.notes == ("some.csv: 4 of 2000 samples are missing; they do not count",)


def test_samples_that_follow_no_clock_are_resampled(model):
    time_s = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 2000)) / RATE_Hz
    series = evenly_spaced(a_recording(time_s, model), model)
    steps_s = np.diff(series.time_s)
    np.testing.assert_allclose(steps_s, steps_s[0], rtol=1e-9)
    assert series.counts.all()
    assert "resampled" in series.notes[0]


@pytest.mark.parametrize(("rest", "first"), [(0, 0), (1500, 1500 - FEWEST_SAMPLES), (2600, 1000)])
def test_of_a_long_recording_the_first_samples_from_its_motion_on_are_taken(model, monkeypatch, rest, first):
    monkeypatch.setattr(preparation, "MOST_SAMPLES", 2000)
    source = a_recording(np.arange(3000) / RATE_Hz, model)
    whole = source.recording.channels[model.input.channel]
    whole[:rest] = whole[rest]
    series = evenly_spaced(source, model)
    np.testing.assert_array_equal(series.command_V, whole[first : first + 2000])
    assert series.start_s == first / RATE_Hz
    (note,) = series.notes
    assert note.startswith("some.csv: has 3000 samples; effects are looked for in 2000 of them, from ")


@pytest.mark.parametrize("levels", [2, 3, 5])
def test_a_converter_of_a_few_levels_moves(model, levels):
    source = a_recording(np.arange(2000) / RATE_Hz, model)
    output = source.recording.channels[model.output.channel]
    step_N = np.ptp(output) / (levels - 1)
    output[:] = step_N * np.round(output / step_N)
    series = evenly_spaced(source, model)
    assert without_frozen(series, model).counts.mean() > 0.5


def test_a_recording_whose_reading_never_moves_is_refused_in_one_line(model):
    source = a_recording(np.arange(2000) / RATE_Hz, model)
    source.recording.channels[model.output.channel][:] = 41.25
    series = evenly_spaced(source, model)
    with pytest.raises(
        RecordingError, match=r"some\.csv: the reading stands still at 41\.25 N .* 9\.99 s; look at the sensor"
    ):
        without_frozen(series, model)
    source.recording.channels[model.output.channel][1500:] = 1.5 * source.recording.channels[model.input.channel][1500:]
    left = without_frozen(evenly_spaced(source, model), model)
    assert left.frozen == ((0, 1500),)
    assert np.count_nonzero(left.counts) == 500


@pytest.mark.parametrize("history_V", [(140.0,), (140.0, 0.0), (90.0, 40.0), (120.0, 20.0, 100.0)])
def test_what_came_before_a_start_amid_the_range_lies_in_its_columns(model, history_V):
    """The columns alone turn the course after one past into that after another, but for a shift."""
    time_s = np.arange(6000) / RATE_Hz
    u = 60.0 + np.minimum(time_s, 10.0) * 5.8 * np.sin(2.0 * np.pi * 0.31 * time_s)
    noise_N = 0.1 * np.random.default_rng(5).standard_normal(u.size)
    source = a_recording(time_s, model)
    source.recording.channels[model.input.channel][:] = u
    source.recording.channels[model.output.channel][:] = driven(model, history_V, u) + noise_N
    series = with_unknown_start(with_start(evenly_spaced(source, model), model), model)
    assert series.time_s.size == u.size
    first = series.past_matters_until
    assert f"its first {first / RATE_Hz:.3g} s depend on what came before" in series.notes[0]
    assert 0 < first < 0.75 * u.size
    apart_N = driven(model, history_V, u) - driven(model, (0.0,), u)
    operator = model.hysteresis.operator()
    stroke_V = operator.stroke(u)
    slope = (operator.output(stroke_V + 0.5) - operator.output(stroke_V - 0.5))[:, None]
    left_N = apart_N - fitted_past(apart_N, slope * series.start_columns)
    assert left_N.std() < 0.05 * apart_N.std()
    assert not np.ptp(series.start_columns[first:], axis=0).any()


def test_without_noise_the_later_cycles_judge(model):
    """What pieces leave of a past is never below no noise; it does not matter once the range has stopped growing."""
    time_s = np.arange(6000) / RATE_Hz
    source = a_recording(time_s, model)
    u = source.recording.channels[model.input.channel]
    u[:] = 50.0 + 40.0 * (1.0 + 2e-4 * time_s) * np.sin(2.0 * time_s)  # it keeps growing a little
    source.recording.channels[model.output.channel][:] = driven(model, (140.0, 0.0), u)
    series = with_unknown_start(with_start(evenly_spaced(source, model), model), model)
    assert "drive the whole range" not in " ".join(series.notes)
    judged = [series.block_counts(block) for block in series.blocks]
    assert judged[-1]
    assert sum(judged) > len(judged) // 2


def driven(model, history_V, u):
    operator = model.hysteresis.operator()
    operator.run(np.array(history_V))
    return operator.run(u)


@pytest.mark.parametrize("seed", range(5))
def test_the_memory_of_a_past_depends_on_the_swept_range_alone(seed):
    """By the definition of the play, for any past and any course: where no more is swept, nothing changes."""
    rng, density = np.random.default_rng(seed), PlayDensity.up_to(60.0)
    u = np.clip(60.0 + np.cumsum(rng.normal(0.0, 4.0, 400)), 0.0, 120.0)
    one, other = ([5.0, *rng.uniform(0.0, 120.0, 4), u[0]] for _ in range(2))
    apart_V = density.columns(u, np.array(one)) - density.columns(u, np.array(other))
    swept_V = np.maximum.accumulate(u) - np.minimum.accumulate(u)
    still = np.diff(swept_V) == 0.0
    assert 0 < np.count_nonzero(still) < still.size
    np.testing.assert_allclose(np.diff(apart_V, axis=0)[still], 0.0, atol=1e-9)


@pytest.mark.parametrize(("first_V", "reach_V"), [(0.0, 0.995 * 90.0), (10.0, 0.995 * 40.0)])
def test_a_recording_from_rest_may_move_every_play_whatever_start_was_estimated(model, first_V, reach_V):
    time_s = time(4000)
    work_V = mixed_work(time_s)
    u = first_V + (90.0 - first_V) * (work_V - work_V.min()) / np.ptp(work_V)
    u = np.concatenate((np.full(500, first_V), np.linspace(first_V, u[0], 500), u))
    one = replace(series(time(u.size), u, 1.8 * u), path_V=(120.0, 0.0))
    chain, _ = chain_of([one], model)
    assert chain.density.thresholds_V[-1] == pytest.approx(reach_V, rel=0.02)


def test_a_thermal_drift_can_be_told_beside_the_recording_that_replaces_missing_ones(model):
    time_s = time(2000)
    warming = series(time_s, mixed_work(time_s), np.zeros(2000), temperature_C=np.linspace(20.0, 21.0, 2000))
    assert recorded_channels([substitute_recording(model), warming]) == ["temperature_C"]
