"""What a verdict on a concealed case is made of, and what becomes of a case that cannot be judged."""

import json
import sys

import pytest

from firmware_sim.concealed.scoring.verdicts import parse_findings
from firmware_sim.concealed.study.catalogue import UNREPEATABLE
from piezod.blind import isolated as apart
from piezod.blind.case import Case, case_folders, read_case
from piezod.blind.cluster import judge_there
from piezod.blind.diagnose_case import UNREPEATED, _repeatable
from piezod.blind.verdict import Verdict, Verdicts, failed_verdict, run_json
from piezod.commissioning.shipped_files import shipped
from piezod.errors import ConfigurationError, UsageError
from piezod.model import load_model
from piezod.model.parameters import EffectValues

DESCRIBED = {
    "schema": "firmware_sim.concealed.case/1",
    "identification": "identification.csv",
    "recordings": ["recording.csv"],
    "held_out": "held_out.csv",
    "input": "voltage_V",
    "output": "force_N",
}


def write_study(folder, cases=2, seal="one"):
    for number in range(1, cases + 1):
        case = folder / f"case_{number:04d}"
        case.mkdir(parents=True)
        (case / "case.json").write_text(json.dumps(DESCRIBED))
        for name in ("identification.csv", "recording.csv", "held_out.csv", "notes.txt"):
            (case / name).write_text(f"{name} of {case.name}")
    (folder / "truth.sealed").write_text("truth")
    (folder / "seal.json").write_text(seal)
    return folder


def test_what_the_scorer_leaves_out_of_the_held_out_target_is_left_out_of_its_simulation():
    assert UNREPEATED == UNREPEATABLE


def test_lasting_effects_stay_in_the_held_out_simulation_and_tones_do_not():
    names = ("electrical_lag", "vibration", "quantisation", "creep")
    effects = tuple(EffectValues.model_construct(name=name) for name in names)
    model = load_model(shipped("model.yaml")).model_copy(update={"effects": effects})
    assert [one.name for one in _repeatable(model).effects] == ["electrical_lag", "creep"]


def test_a_case_carries_the_files_that_it_names_and_no_other(tmp_path):
    case = read_case(write_study(tmp_path / "study") / "case_0002")
    assert set(case.files) == {"case.json", "identification.csv", "recording.csv", "held_out.csv"}
    there = tmp_path / "there"
    there.mkdir()
    case.unpack(there)
    assert (there / "recording.csv").read_text() == "recording.csv of case_0002"


@pytest.mark.parametrize("name", ["../truth.sealed", "/etc/passwd", "sealed/case_0001.sealed"])
def test_a_case_that_names_a_file_elsewhere_is_refused(tmp_path, name):
    folder = write_study(tmp_path) / "case_0001"
    (folder / "case.json").write_text(json.dumps(DESCRIBED | {"held_out": name}))
    with pytest.raises(ConfigurationError, match="must be files beside it"):
        read_case(folder)


def test_a_study_without_its_seal_is_not_finished(tmp_path):
    study = write_study(tmp_path)
    assert [one.name for one in case_folders(study)] == ["case_0001", "case_0002"]
    (study / "seal.json").unlink()
    with pytest.raises(ConfigurationError, match="no finished study"):
        case_folders(study)


@pytest.mark.parametrize("truth", ["null", "foreign"])
def test_a_failed_case_is_wrong_whether_nothing_is_there_or_something_unknown(truth):
    said = parse_findings(json.loads(failed_verdict("case_0001", "out of\nmemory").files["findings.json"]))
    if truth == "null":
        assert said.verdict not in {"matches", "not_testable"}
    else:
        assert not said.flagged
    assert said.names == frozenset()


def test_verdicts_on_another_study_are_not_added_to(tmp_path):
    Verdicts(tmp_path / "verdicts", write_study(tmp_path / "a", seal="one"))
    with pytest.raises(UsageError, match="verdicts on another study"):
        Verdicts(tmp_path / "verdicts", write_study(tmp_path / "b", seal="another"))


def test_a_case_counts_as_judged_once_its_verdict_is_whole_and_no_failure(tmp_path):
    verdicts = Verdicts(tmp_path / "verdicts", write_study(tmp_path / "study"))
    assert not verdicts.has("case_0001")
    verdicts.keep(failed_verdict("case_0001", "no"))
    assert not verdicts.has("case_0001")
    verdicts.keep(Verdict("case_0001", {"findings.json": b"{}", "run.json": run_json(1.0)}))
    assert verdicts.has("case_0001")
    (tmp_path / "verdicts" / "case_0001" / "findings.json").unlink()
    assert not verdicts.has("case_0001")


def test_a_case_whose_process_dies_every_time_has_failed(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    verdict = apart.judge_apart(Case("case_0001", {}))
    assert verdict.failed == "its process ended with 1, 3 times"
    assert json.loads(verdict.files["run.json"])["failed"] == verdict.failed


def test_a_cluster_without_its_library_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'piezod-bench\[cluster\]'"):
        next(judge_there([], "tcp://127.0.0.1:8786"))
