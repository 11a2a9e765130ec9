"""Drift: two windows in a row above the limit, and a recording of bounded size."""

from pathlib import Path

import numpy as np
import pytest

from piezod.config import DriftConfig, load_bench
from piezod.control import ROW_DTYPE, State
from piezod.daemon.drift import WINDOWS, DriftWatch
from piezod.model import load_model
from piezod.recording import read_csv

CONFIG = Path(__file__).parents[3] / "config"
RATE_HZ, WINDOW_S, KEEP_S = 100.0, 2.0, 20.0


@pytest.fixture
def model():
    return load_model(CONFIG / "model.yaml")


@pytest.fixture
def logged():
    return []


@pytest.fixture
def watch(model, logged, tmp_path):
    drift = DriftConfig(window_s=WINDOW_S, keep_s=KEEP_S, beyond_N=1.0, file=str(tmp_path / "{name}.csv"))
    bench = load_bench(CONFIG / "bench.yaml").model_copy(update={"rate_Hz": RATE_HZ, "drift": drift})
    return DriftWatch(bench, model, logged.append)


def rows_of(model, seconds, extra=lambda t: 0.0, first_tick=0):
    """Rows of a slow sine of voltage, disarmed, arming and running; each reading follows the voltage one row before."""
    count = round(seconds * RATE_HZ)
    rows = np.zeros(count, ROW_DTYPE)
    t = np.arange(count) / RATE_HZ
    voltage_V = 60.0 * (1.0 - np.cos(2.0 * np.pi * 0.3 * np.maximum(t - 0.5, 0.0)))
    force_N = model.operator().run(voltage_V) + np.array([extra(one) for one in t])
    rows["tick"] = first_tick + np.arange(count)
    rows["voltage_V"], rows["force_N"][1:], rows["temperature_C"] = voltage_V, force_N[:-1], 20.0
    rows["state"] = np.where(t < 0.2, State.DISARMED, np.where(t < 0.5, State.ARMING, State.RUNNING))
    return rows


def add_in_pieces(watch, rows, size=7):
    for first in range(0, rows.size, size):
        watch.add(rows[first : first + size])


def test_a_bench_that_behaves_like_its_model_shows_no_difference(watch, model, logged):
    add_in_pieces(watch, rows_of(model, 12.0))
    assert watch.windows == 5
    assert watch.rms_N < 1e-6
    assert abs(watch.offset_N) < 1e-6
    assert not watch.drifted
    assert logged == []


def test_rms_and_offset_are_those_of_the_last_window(watch, model):
    """A sine of 0.5 N with whole periods in a window: rms 0.5 / sqrt(2), no offset."""
    add_in_pieces(watch, rows_of(model, 8.6, lambda t: 0.5 * np.sin(2.0 * np.pi * 2.0 * t)))
    assert watch.rms_N == pytest.approx(0.5 / np.sqrt(2.0), rel=1e-3)
    assert watch.offset_N == pytest.approx(0.0, abs=1e-3)


def test_one_window_above_the_limit_is_not_a_drift_and_two_in_a_row_are(watch, model, logged):
    once = rows_of(model, 13.0, lambda t: 3.0 if 4.6 < t < 6.4 else 0.0)
    add_in_pieces(watch, once)
    assert not watch.drifted
    stays = rows_of(model, 13.0, lambda t: 3.0 if t > 8.5 else 0.0, first_tick=once.size)
    watch.begin()
    add_in_pieces(watch, stays)
    assert watch.drifted
    assert watch.offset_N == pytest.approx(3.0, abs=1e-6)
    assert len(logged) == 1
    assert WINDOWS == 2


def test_the_recording_begins_at_arming(watch, model, tmp_path):
    rows = rows_of(model, 12.0, lambda t: 4.0 * np.sin(5.0 * t))
    add_in_pieces(watch, rows)
    assert watch.drifted
    watch.close()
    recording = read_csv(tmp_path / "emulator.csv")
    assert recording.channel("voltage_V")[0] == 0.0
    armed = int(np.flatnonzero(rows["state"] == State.ARMING)[0])
    np.testing.assert_allclose(recording.channel("voltage_V"), rows["voltage_V"][armed - 1 : -1], rtol=1e-8)
    np.testing.assert_allclose(recording.channel("force_N"), rows["force_N"][armed:], rtol=1e-8)
    assert watch.as_dict()["kept"] == str(tmp_path / "emulator.csv")


def test_no_more_rows_are_collected_than_configured(watch, model):
    add_in_pieces(watch, rows_of(model, 5.0 * KEEP_S))
    assert sum(part.size for part in watch._armed_rows) <= KEEP_S * RATE_HZ


def test_missed_ticks_and_failed_exchanges_cause_no_difference(watch, model):
    rows = rows_of(model, 12.0)
    rows = np.delete(rows, np.arange(400, 420))
    rows["result"][600:610] = 3
    rows["force_N"][600:610] = 1e6
    add_in_pieces(watch, rows)
    assert watch.windows >= 4
    # over a gap the model continues with the last voltage, while the bench went on: small against the limit
    assert not watch.drifted


def test_the_default_limit_is_three_times_the_held_out_error_of_the_model(model, logged):
    bench = load_bench(CONFIG / "bench.yaml")
    own = model.model_copy(
        update={
            "provenance": model.provenance.model_copy(
                update={"fit": model.provenance.fit.model_copy(update={"rms_held_out": 0.2})}
            )
        }
    )
    assert DriftWatch(bench, own, logged.append).limit_N == pytest.approx(0.6)
