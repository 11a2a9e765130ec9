"""Recordings made ready: a clock that skips a tick, and samples that follow no clock."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezod.diagnose.hypothesis.basis import PlayDensity
from piezod.diagnose.prepare import Source, chain_of, even, started, without_frozen, without_unknown
from piezod.errors import RecordingError
from piezod.estimation.initial_state import remembered
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


@pytest.mark.parametrize("levels", [2, 3, 5])
def test_a_converter_of_a_few_levels_moves(model, levels):
    source = a_recording(np.arange(2000) / RATE_Hz, model)
    output = source.recording.channels[model.output.channel]
    step_N = np.ptp(output) / (levels - 1)
    output[:] = step_N * np.round(output / step_N)
    series, _ = even(source, model)
    assert without_frozen(series, model)[0].counts.mean() > 0.5


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
    assert np.count_nonzero(left.counts) == 500


def test_what_came_before_a_start_amid_the_range_is_left_out_and_what_followed_is_remembered(model):
    time_s = np.arange(6000) / RATE_Hz
    u = 60.0 + np.minimum(time_s, 10.0) * 5.8 * np.sin(2.0 * np.pi * 0.31 * time_s)
    readings_N = []
    for history_V in ((140.0,), (140.0, 0.0), (90.0, 40.0)):
        operator = model.hysteresis.operator()
        operator.run(np.array(history_V))
        readings_N.append(operator.run(u))
    noise_N = 0.1 * np.random.default_rng(5).standard_normal(u.size)
    source = a_recording(time_s, model)
    source.recording.channels[model.input.channel][:] = u
    source.recording.channels[model.output.channel][:] = readings_N[0] + noise_N
    series, said = without_unknown(started(even(source, model)[0], model), model)
    first = u.size - series.time_s.size
    assert 0 < first < 0.75 * u.size
    assert f"its first {first / RATE_Hz:.3g} s depend on what came before" in said[0]
    apart_N = np.ptp([one - one[-1] for one in readings_N], axis=0)
    assert apart_N[first:].max() < 0.03 * apart_N.max()
    operator = model.hysteresis.operator()
    operator.run(np.array(series.path_V))
    simulated_N = operator.run(series.command_V)
    shift_N = readings_N[0][-1] - simulated_N[-1]
    np.testing.assert_allclose(simulated_N + shift_N, readings_N[0][first:], atol=0.03 * apart_N.max())
    assert series.start_s == pytest.approx(first / RATE_Hz)


def test_the_largest_reversals_are_all_that_plays_remember():
    rng, density = np.random.default_rng(0), PlayDensity.up_to(60.0)
    for samples in (1, 2, 3, 17, 300):
        for _ in range(20):
            u = np.clip(np.cumsum(rng.normal(0.0, 8.0, samples)) + 40.0, 0.0, 120.0)
            then = u[-1] + rng.normal(0.0, 20.0, 50)
            short = density.columns(then, np.array([5.0, *remembered(u)]))
            np.testing.assert_allclose(short, density.columns(then, np.array([5.0, *u])), atol=1e-9)


@pytest.mark.parametrize(("first_V", "reach_V"), [(0.0, 0.995 * 90.0), (10.0, 0.995 * 40.0)])
def test_a_recording_from_rest_may_move_every_play_whatever_start_was_estimated(model, first_V, reach_V):
    time_s = time(4000)
    work_V = mixed_work(time_s)
    u = first_V + (90.0 - first_V) * (work_V - work_V.min()) / np.ptp(work_V)
    u = np.concatenate((np.full(500, first_V), np.linspace(first_V, u[0], 500), u))
    one = replace(series(time(u.size), u, 1.8 * u), path_V=(120.0, 0.0))
    chain, _ = chain_of([one], model)
    assert chain.density.thresholds_V[-1] == pytest.approx(reach_V, rel=0.02)
