"""The report of a run, computed from its recording alone."""

import json

import numpy as np
import pytest

from piezod.control import Cause, State
from piezod.errors import RecordingError
from piezod.recording import Recording
from piezod.report.run import run_figures, write_run_page


def recording(states, causes=None, dt_s=0.01, **channels):
    states = np.asarray(states, dtype=float)
    size = states.size
    causes = np.zeros(size) if causes is None else np.asarray(causes, dtype=float)
    made = {
        "state": states,
        "cause": causes,
        "tick": np.arange(size, dtype=float),
        "reference_N": np.full(size, 10.0),
        "force_N": np.full(size, 10.0),
        "voltage_V": np.linspace(0.0, 5.0, size),
    }
    return Recording(np.arange(size) * dt_s, made | channels, {}, "press-000001.sqlite")


def test_the_error_uses_ticks_whose_command_and_answer_are_both_in_running():
    force = np.array([0.0, 0.0, 13.0, 9.0, 50.0])
    states = [State.ARMING, State.RUNNING, State.RUNNING, State.RUNNING, State.RAMP_DOWN]
    figures = run_figures(recording(states, force_N=force))
    assert figures.rms_error_N == pytest.approx(np.sqrt((9 + 1) / 2))
    assert figures.max_error_N == 3.0
    assert figures.running_s == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("states", "causes", "says"),
    [
        ([2, 2, 5], [2, 2, 8], "ended in FAULT, force above limits.force_trip_N; check specimen"),
        ([2, 4, 0], [2, 3, 13], "ended in DISARMED"),
        ([0, 1, 2], [0, 1, 2], "interrupted in RUNNING"),
    ],
)
def test_the_verdict_names_the_last_state(states, causes, says):
    assert run_figures(recording(states, causes)).sentence.startswith(says)


def test_missed_ticks_are_gaps_in_the_tick_number():
    figures = run_figures(recording([2, 2, 2], tick=np.array([5.0, 6.0, 9.0])))
    assert figures.missed == 2
    assert "2 ticks missed" in figures.sentence


def test_transitions_are_in_order_and_json_can_hold_them():
    figures = run_figures(recording([1, 2, 2, 5], [Cause.ARMED, 2, 2, Cause.OVER_FORCE]))
    written = json.loads(json.dumps(figures.as_dict()))
    assert [(one["time_s"], one["state"]) for one in written["transitions"]] == [
        (0.0, "ARMING"),
        (0.01, "RUNNING"),
        (0.03, "FAULT"),
    ]


def test_a_recording_of_another_program_has_a_page(tmp_path):
    bare = Recording(np.arange(50) * 0.01, {"voltage_V": np.arange(50.0), "displacement_um": np.arange(50.0)})
    figures = run_figures(bare)
    write_run_page(tmp_path / "run.html", bare, figures)
    assert figures.sentence == "recorded: 0.5 s, 0.5 s in RUNNING"
    assert "Voltage" in (tmp_path / "run.html").read_text(encoding="utf-8")


def test_a_recording_without_samples_is_refused():
    with pytest.raises(RecordingError, match="has no sample to report"):
        run_figures(recording([]))


def test_the_page_lists_the_changes_of_state(tmp_path):
    made = recording([1, 2, 5], [1, 2, 8], lateness_ns=np.array([1e4, 2e4, 3e4]), exchange_ns=np.array([1e5, 2e5, 3e5]))
    write_run_page(tmp_path / "run.html", made, run_figures(made))
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert "check specimen, reference and load cell" in page
    names = sorted(one.name for one in (tmp_path / "run.data").iterdir())
    assert "01-force.csv" in names
    assert names[-1].endswith("how-long-an-exchange-took.csv")
