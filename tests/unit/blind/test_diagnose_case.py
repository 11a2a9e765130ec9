"""Verdicts on concealed cases: their files, their folder, and cases whose diagnosis fails."""

import json
import sys

import pytest

from firmware_sim.concealed.scoring.verdicts import parse_findings
from firmware_sim.concealed.study.catalogue import UNREPEATABLE
from piezod.blind.case import WORKER, case_folders, read_case
from piezod.blind.diagnose_case import repeatable
from piezod.blind.verdict import Verdict, VerdictFolder, as_verdict, failed_verdict, run_json
from piezod.commissioning.shipped_files import shipped
from piezod.effects import EFFECTS
from piezod.errors import ConfigurationError, UsageError
from piezod.model import load_model
from piezod.model.parameters import EffectValues
from piezod.tasks.cluster import run_on_cluster
from piezod.tasks.isolated import run_isolated
from piezod.tasks.task import Task

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


def test_the_effects_left_out_of_the_held_out_simulation_are_those_left_out_of_its_target():
    assert {name for name, effect in EFFECTS.items() if not effect.repeats} == UNREPEATABLE


def test_the_held_out_simulation_keeps_lasting_effects_and_drops_tones():
    names = ("electrical_lag", "vibration", "quantisation", "creep")
    effects = tuple(EffectValues.model_construct(name=name) for name in names)
    model = load_model(shipped("model.yaml")).model_copy(update={"effects": effects})
    assert [effect.name for effect in repeatable(model).effects] == ["electrical_lag", "creep"]


def test_a_case_holds_only_the_files_that_its_description_names(tmp_path):
    case = read_case(write_study(tmp_path / "study") / "case_0002")
    assert set(case.files) == {"case.json", "identification.csv", "recording.csv", "held_out.csv"}
    folder = tmp_path / "unpacked"
    folder.mkdir()
    case.unpack(folder)
    assert (folder / "recording.csv").read_text() == "recording.csv of case_0002"


@pytest.mark.parametrize("name", ["../truth.sealed", "/etc/passwd", "sealed/case_0001.sealed"])
def test_a_case_that_names_a_file_outside_its_folder_is_refused(tmp_path, name):
    folder = write_study(tmp_path) / "case_0001"
    (folder / "case.json").write_text(json.dumps(DESCRIBED | {"held_out": name}))
    with pytest.raises(ConfigurationError, match="must be files beside it"):
        read_case(folder)


def test_a_study_without_its_seal_is_not_finished(tmp_path):
    study = write_study(tmp_path)
    assert [folder.name for folder in case_folders(study)] == ["case_0001", "case_0002"]
    (study / "seal.json").unlink()
    with pytest.raises(ConfigurationError, match="no finished study"):
        case_folders(study)


@pytest.mark.parametrize("truth", ["null", "foreign"])
def test_a_failed_case_is_wrong_for_a_null_and_for_a_foreign_truth(truth):
    verdict = parse_findings(json.loads(failed_verdict("case_0001", "out of\nmemory").files["findings.json"]))
    if truth == "null":
        assert verdict.verdict not in {"matches", "not_testable"}
    else:
        assert not verdict.flagged
    assert verdict.names == frozenset()


def test_a_folder_with_verdicts_on_another_study_is_refused(tmp_path):
    VerdictFolder(tmp_path / "verdicts", write_study(tmp_path / "a", seal="one"))
    with pytest.raises(UsageError, match="verdicts on another study"):
        VerdictFolder(tmp_path / "verdicts", write_study(tmp_path / "b", seal="another"))


def test_a_case_has_a_verdict_if_the_verdict_is_complete_and_no_failure(tmp_path):
    verdicts = VerdictFolder(tmp_path / "verdicts", write_study(tmp_path / "study"))
    assert not verdicts.has("case_0001")
    verdicts.save(failed_verdict("case_0001", "no"))
    assert not verdicts.has("case_0001")
    verdicts.save(Verdict("case_0001", {"findings.json": b"{}", "run.json": run_json(1.0)}))
    assert verdicts.has("case_0001")
    (tmp_path / "verdicts" / "case_0001" / "findings.json").unlink()
    assert not verdicts.has("case_0001")


def test_a_case_whose_process_dies_at_every_attempt_has_failed(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    verdict = as_verdict(run_isolated(Task("case_0001", {}, WORKER)))
    assert verdict.failed == "its process ended with 1, 3 times"
    assert json.loads(verdict.files["run.json"])["failed"] == verdict.failed


def test_a_missing_cluster_library_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'piezod-bench\[cluster\]'"):
        next(run_on_cluster(lambda: None, "tcp://127.0.0.1:8786"))
