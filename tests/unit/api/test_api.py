"""`import piezod`: the page, the notebook, and what a caller may give."""

import contextlib
import doctest
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import piezod
from piezod.errors import RecordingError, UsageError
from piezod.recording import write_csv

ROOT = Path(__file__).parents[3]
TIME_S = np.arange(0.0, 6.0, 0.005)
VOLTAGE_V = 20.0 * TIME_S * (1.0 - abs(1.0 - TIME_S % 2.0))


@pytest.fixture(scope="module")
def stack():
    return piezod.Model.load(ROOT / "config" / "model.yaml")


@pytest.fixture(scope="module")
def recording(stack):
    answer = piezod.simulate(piezod.Recording(TIME_S, {"voltage_V": VOLTAGE_V}), stack).channel("force_N")
    noise_N = np.random.default_rng(3).normal(0.0, 0.1, TIME_S.size)
    return piezod.Recording(TIME_S, {"voltage_V": VOLTAGE_V, "force_N": answer + noise_N})


def test_every_line_of_the_page_gives_what_it_says():
    with contextlib.chdir(ROOT):
        result = doctest.testfile(str(ROOT / "piezod" / "api" / "README.md"), module_relative=False)
    assert result.attempted > 15
    assert result.failed == 0


def test_the_notebook_runs_and_shows_its_results():
    notebook = json.loads((ROOT / "config" / "examples" / "diagnosis.ipynb").read_text())
    names: dict[str, object] = {}
    with contextlib.chdir(ROOT / "config" / "examples"):
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]), names)
    for name in ("found", "diagnosis"):
        shown = names[name]._repr_html_()
        assert "<svg" in shown
        assert str(names[name])[1:20] in shown


def test_a_file_an_array_and_a_frame_are_the_same_recording(recording, tmp_path):
    write_csv(recording, tmp_path / "rec.csv")
    given = (tmp_path / "rec.csv", str(tmp_path / "rec.csv"), recording, recording.frame())
    verdicts = {piezod.identify(one).verdict for one in given}
    assert len(verdicts) == 1


def test_identify_does_not_change_its_recording(recording):
    stuck = recording.channel("force_N").copy()
    stuck[300:400] = stuck[300]
    given = piezod.Recording(TIME_S, {"voltage_V": VOLTAGE_V, "force_N": stuck.copy()})
    piezod.identify(given)
    assert np.array_equal(given.channel("force_N"), stuck)


def test_lists_and_whole_numbers_make_a_recording():
    made = piezod.Recording([0, 1, 2], {"voltage_V": [0, 5, 10]})
    assert made.channel("voltage_V").dtype == np.float64


@pytest.mark.parametrize(
    ("values", "problem"),
    [([0, 5], "2 samples"), (["a", "b", "c"], "must hold numbers"), ([[0, 5, 1]], "one row of samples")],
)
def test_what_is_no_channel_is_refused(values, problem):
    with pytest.raises(RecordingError, match=problem):
        piezod.Recording([0, 1, 2], {"voltage_V": values})


def test_a_frame_over_dates_counts_seconds_from_the_first():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"force_N": [1.0, 2.0, 3.0]}, index=pd.date_range("2026-11-26", periods=3, freq="10ms"))
    assert np.allclose(piezod.Recording.from_frame(frame).time_s, [0.0, 0.01, 0.02])


@pytest.mark.parametrize("given", [None, 5, {"voltage_V": [1.0]}])
def test_what_is_no_recording_is_refused_in_a_line(given):
    with pytest.raises(UsageError, match="must be a path, a Recording or a pandas frame"):
        piezod.identify(given)


def test_no_recording_is_refused():
    with pytest.raises(UsageError, match="at least one"):
        piezod.identify([])


def test_a_model_of_the_interface_is_saved_and_read_as_it_is(stack, tmp_path):
    stack.save(tmp_path / "model.yaml")
    assert piezod.Model.load(tmp_path / "model.yaml") == stack


def test_the_inverse_of_a_rate_that_is_none_is_refused(stack):
    with pytest.raises(UsageError, match="rate_Hz is 0"):
        stack.inverse(0.0)


def test_the_inverse_stays_within_the_identified_range(stack):
    voltages = stack.inverse(1000.0).voltages([-1e6, 1e6, 50.0])
    assert stack.input.low <= voltages.min()
    assert voltages.max() <= stack.input.high


def test_functions_are_found_whatever_was_imported_first():
    for room in ("piezod.identify", "piezod.diagnose.diagnosis"):
        importlib.import_module(room)
        assert callable(piezod.identify)
        assert callable(piezod.diagnose)
    from piezod import diagnose

    assert diagnose is piezod.diagnose


def test_the_import_brings_neither_solver_nor_plots():
    code = "import sys, piezod; print([m for m in ('numba', 'numpy', 'bokeh', 'proxsuite') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ)
    assert done.stdout.strip() == "[]"


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'identifi'"):
        _ = piezod.identifi


@pytest.mark.parametrize("factor", [1e-12, 1e-6, 1e6])
def test_a_unit_that_makes_numbers_tiny_or_huge_gives_the_same_verdict(recording, factor):
    scaled = piezod.Recording(TIME_S, {"voltage_V": VOLTAGE_V, "force_GN": factor * recording.channel("force_N")})
    found, usual = piezod.identify(scaled, output="force_GN"), piezod.identify(recording)
    assert found.error == pytest.approx(factor * usual.error, rel=0.02)
    assert found.identification.explained == pytest.approx(usual.identification.explained, abs=1e-4)


def test_the_command_returns_behind_a_useful_model_as_commissioning_needs(recording, tmp_path, capsys):
    from piezod.cli.models import identify

    write_csv(recording, tmp_path / "rec.csv")
    assert identify([tmp_path / "rec.csv"], tmp_path / "model.yaml") is None
    assert "error on held-out data" in capsys.readouterr().out


def test_a_history_of_no_path_is_refused_in_a_sentence():
    for wrong in ([], 5, [None]):
        with pytest.raises(UsageError, match="must be"):
            piezod.history(wrong)
