"""Facts of a run: names, shares, drift, and the reason of its largest error."""

import numpy as np
import pytest

from piezod.control import State
from piezod.recording import Recording, write_recording
from piezod.report.run_facts import drifted_at, fact_rows, outlier_reason
from piezod.transport.link import ExchangeResult

SIZE = 2000
WORST = 1500
BEGAN_S = 1_800_000_000.0  # 2027-01-15 08:00:00 UTC


def error_with(values):
    error = 0.1 * np.sin(np.arange(SIZE))
    error[WORST - len(values) + 1 : WORST + 1] = values
    return error


def run(metadata=None, **channels):
    made = {
        "state": np.full(SIZE, float(State.RUNNING)),
        "tick": np.arange(SIZE, dtype=float),
        "result": np.zeros(SIZE),
        "voltage_V": np.linspace(0.0, 100.0, SIZE),
        "planned_V": np.linspace(0.0, 100.0, SIZE),
        "reference_N": np.linspace(0.0, 200.0, SIZE),
        "wall_s": BEGAN_S + 0.01 * np.arange(SIZE),
    }
    return Recording(np.arange(SIZE) * 0.01, made | channels, metadata or {}, "press.sqlite")


def at(index, value, start=None):
    values = np.zeros(SIZE) if start is None else start.copy()
    values[index] = value
    return values


def skipped():
    tick = np.arange(SIZE, dtype=float)
    tick[WORST - 2 :] += 3.0
    return tick


def turning():
    return 100.0 - np.abs(np.arange(SIZE) - (WORST - 4.0))


WIDE = (3.0, 3.1, 3.2)
ALONE = (5.0,)


@pytest.mark.parametrize(
    ("channels", "values", "says"),
    [
        (
            {"result": at(WORST - 3, ExchangeResult.TIMEOUT)},
            WIDE,
            "1 exchanges before it failed, the last with TIMEOUT",
        ),
        ({"tick": skipped()}, WIDE, "3 ticks before it were missed"),
        ({"planned_V": at(WORST - 1, 130.0, np.linspace(0.0, 100.0, SIZE))}, WIDE, "a limit of voltage"),
        ({}, ALONE, "a single sample; look for a disturbance of the load cell"),
        ({"reference_N": turning()}, WIDE, "the reference turns there"),
        ({}, WIDE, "the recording shows no reason"),
    ],
)
def test_an_outlier_has_its_reason(channels, values, says):
    reason = outlier_reason(run(**channels), error_with(values))
    assert says in reason
    assert reason.startswith(f"at {0.01 * WORST:.3f} s")


def test_an_error_soon_after_the_begin_belongs_to_the_approach():
    error = np.full(SIZE, np.nan)
    error[WORST - 50 :] = 0.01
    error[WORST - 1 : WORST + 1] = 3.0
    assert "had just begun to follow" in outlier_reason(run(), error)


def test_an_even_error_has_no_outlier():
    assert outlier_reason(run(), 0.1 * np.sin(np.arange(SIZE))) is None


def test_the_facts_name_bench_model_limits_date_and_shares():
    tick = np.arange(SIZE, dtype=float)
    tick[1000:] += 10.0
    made = run({"bench": "press", "model": "m.yaml", "limits": "0 to 120 V"}, tick=tick)
    rows = fact_rows(made, error_with(ALONE))
    assert ["bench", "press"] in rows
    assert ["model", "m.yaml"] in rows
    assert ["limits", "0 to 120 V"] in rows
    assert ["began", "2027-01-15 08:00:00 UTC"] in rows
    assert ["missed ticks", "10 of 2010 (0.5 %)"] in rows
    assert ["failed exchanges", "0 of 2000 (none)"] in rows


@pytest.mark.parametrize(
    ("recorded", "inside"), [("2027-01-15T08:00:10+00:00", True), ("2027-01-15T07:59:50+00:00", False)]
)
def test_a_run_has_drifted_if_the_kept_recording_lies_within_it(recorded, inside, tmp_path):
    kept = tmp_path / "drift.csv"
    write_recording(Recording(np.arange(3.0), {"force_N": np.arange(3.0)}, {"recorded": recorded}), kept)
    made = run({"drift_file": str(kept)})
    assert drifted_at(made) == (recorded if inside else "")
    assert any("DRIFTED" in row[1] for row in fact_rows(made, None)) == inside


def test_a_run_without_a_kept_recording_has_not_drifted():
    assert drifted_at(run({"drift_file": "/nowhere/drift.csv"})) == ""
    assert drifted_at(run()) == ""
