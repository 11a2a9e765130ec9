"""Drift: windows are compared with the limit, then with known ones; a recording of bounded size."""

import threading
from pathlib import Path

import numpy as np
import pytest

from piezod.config import load_bench
from piezod.config.sections import DriftConfig
from piezod.control import ROW_DTYPE, State
from piezod.daemon.drift import DriftWatch
from piezod.daemon.drift.reference import FIRST_STRETCH
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


def bench_of(folder, **changes):
    files = {"file": str(folder / "{name}.csv"), "blocks": str(folder / "{name}.blocks.csv")}
    settings = {"window_s": WINDOW_S, "keep_s": KEEP_S, "beyond_N": 1.0, "false_alarm_days": 73} | files | changes
    drift = DriftConfig(**settings)
    return load_bench(CONFIG / "bench.yaml").model_copy(update={"rate_Hz": RATE_HZ, "drift": drift})


@pytest.fixture
def watch(model, logged, tmp_path):
    return DriftWatch(bench_of(tmp_path), model, logged.append)


def rows_of(model, seconds, extra=lambda t: 0.0, first_tick=0, frequency_Hz=0.5, noise_N=0.0):
    """Rows of a slow sine of voltage, disarmed, arming and running; each reading follows the voltage one row before."""
    count = round(seconds * RATE_HZ)
    rows = np.zeros(count, ROW_DTYPE)
    t = np.arange(count) / RATE_HZ
    voltage_V = 60.0 * (1.0 - np.cos(2.0 * np.pi * frequency_Hz * np.maximum(t - 0.5, 0.0)))
    noise = noise_N * np.random.default_rng(first_tick).standard_normal(count)
    force_N = model.operator().run(voltage_V) + np.array([extra(one) for one in t]) + noise
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


@pytest.mark.parametrize(("above", "drifts"), [(3, False), (4, True)])
def test_four_windows_above_the_limit_are_a_drift_in_the_first_stretch(watch, model, logged, above, drifts):
    """73 days are 3.15 million windows of 2 s, and a window above the limit pays 50.5 times: 50.5^4 is 6.5 million."""
    last_s = 4.5 + above * WINDOW_S
    add_in_pieces(watch, rows_of(model, 21.0, lambda t: 3.0 if 4.6 < t < last_s - 0.05 else 0.0), size=1)
    assert watch.drifted == drifts
    assert len(logged) == drifts
    if drifts:
        assert "limit 1.00 N; in the first stretch of driving" in logged[0]


def test_the_first_stretch_takes_an_hour_of_windows_and_a_tripled_error_is_then_a_drift(model, logged, tmp_path):
    """The error grows from 0.1 to 0.3 N rms, far below `beyond_N`."""
    watch = DriftWatch(bench_of(tmp_path), model, logged.append)
    usual = rows_of(model, 0.5 + WINDOW_S * (FIRST_STRETCH + 20), noise_N=0.1)
    watch.add(usual)
    assert not watch.drifted
    assert logged == [f"drift: from now on compared with driving of this bench, first with {FIRST_STRETCH} windows"]
    assert watch.as_dict()["first_stretch"] is False
    watch.close()

    logged.clear()
    later = DriftWatch(bench_of(tmp_path), model, logged.append)
    assert later.test.reference.size == watch.test.reference.size
    assert "drift.beyond_N has no effect" in logged[0]
    later.add(rows_of(model, 0.5 + 20 * WINDOW_S, noise_N=0.1))
    assert not later.drifted
    later.begin()
    last_tick = round((0.5 + 20 * WINDOW_S) * RATE_HZ)
    later.add(rows_of(model, 0.5 + 8 * WINDOW_S, noise_N=0.3, first_tick=last_tick))
    assert later.drifted
    assert "the law of the bench has changed" in logged[-1]
    assert "0.10 N so far" in logged[-1]


def test_another_input_after_the_first_stretch_is_no_drift_however_large_its_error_is(model, logged, tmp_path):
    watch = DriftWatch(bench_of(tmp_path), model, logged.append)
    watch.add(rows_of(model, 0.5 + WINDOW_S * (FIRST_STRETCH + 20), noise_N=0.1))
    watch.close()
    logged.clear()
    faster = DriftWatch(bench_of(tmp_path, beyond_N=None), model, logged.append)
    faster.add(rows_of(model, 0.5 + 20 * WINDOW_S, noise_N=5.0, frequency_Hz=5.0))
    assert not faster.drifted
    assert faster.outside_windows == faster.windows >= 19
    assert len(logged) == 1
    assert logged[0].startswith("drift: another input, not compared: rate ")
    assert "known " in faster.as_dict()["outside"]


def test_an_unknown_input_beyond_the_range_of_the_model_is_not_compared(model, logged, tmp_path):
    """The model is known to 140 V; the sine reaches 120 V, and the range ends at 100 V here."""
    narrow = model.model_copy(update={"input": model.input.model_copy(update={"high": 100.0})})
    watch = DriftWatch(bench_of(tmp_path), narrow, logged.append)
    watch.add(rows_of(model, 20.5, lambda t: 3.0 * np.sin(40.0 * t)))
    assert not watch.drifted
    assert watch.outside_windows == watch.windows


def test_windows_of_another_model_are_not_used(model, logged, tmp_path):
    watch = DriftWatch(bench_of(tmp_path), model, logged.append)
    watch.add(rows_of(model, 0.5 + WINDOW_S * 40, noise_N=0.1))
    watch.close()
    assert DriftWatch(bench_of(tmp_path), model, logged.append).test.reference.size > 0
    other = model.model_copy(update={"name": "other"})
    assert DriftWatch(bench_of(tmp_path), other, logged.append).test.reference.size == 0


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


def test_an_alarm_in_the_batch_that_ends_disarmed_writes_the_ticks_of_that_drive(watch, model, logged):
    """The rows of a whole drive come at once, as after a pause of the daemon: armed, changed, at rest again."""
    rows = rows_of(model, 15.0, lambda t: 3.0 if t > 2.5 else 0.0)
    rows["state"][-20:] = State.DISARMED
    watch.add(rows)
    watch.close()
    assert watch.drifted
    assert watch.problem == ""
    assert read_csv(watch.path).time_s.size > 10.0 * RATE_HZ


@pytest.mark.parametrize("last", [State.DISARMED, State.FAULT, State.RUNNING])
@pytest.mark.parametrize("pieces", [1, 3, 100_000])
def test_an_alarm_ends_in_a_file_however_the_rows_are_cut_and_whatever_their_last_state_is(watch, model, last, pieces):
    rows = rows_of(model, 15.0, lambda t: 3.0 if t > 2.5 else 0.0)
    rows["state"][-20:] = last
    add_in_pieces(watch, rows, size=max(1, rows.size // pieces))
    watch.close()
    assert watch.drifted
    assert watch.path.is_file()


def test_a_disk_that_stands_delays_no_window(watch, model, monkeypatch):
    """The first write stands until the end of the test; windows and alarm go on, and the newest content follows."""
    goes_on, written = threading.Event(), []

    def write(_, rows):
        goes_on.wait(30.0)
        written.append(rows)

    monkeypatch.setattr("piezod.daemon.drift.watch.SAVED_EVERY", 1)
    monkeypatch.setattr("piezod.daemon.drift.files.BlocksFile.write", write)
    add_in_pieces(watch, rows_of(model, 12.0))
    assert watch.windows == 5
    assert written == []
    goes_on.set()
    watch.close()
    assert len(written) == 2  # the one that stood, and the newest of those that waited
    assert len(written[1]) >= len(written[0])
