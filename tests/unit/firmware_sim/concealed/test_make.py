"""A study is the same for the same seed, says nothing outside the seal, and its effects are as strong as it says."""

import json
from pathlib import Path

import numpy as np
import pytest

import piezod
from firmware_sim.concealed.cli import main
from firmware_sim.concealed.errors import SealError, StudyError
from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.plant.sampling import frozen, quantised
from firmware_sim.concealed.study.case import effects_in
from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.entry import COME_SINCE
from firmware_sim.concealed.study.make import make
from firmware_sim.concealed.study.plan import KINDS, case_specs
from firmware_sim.concealed.study.seal import open_truth, unpack_arrays
from firmware_sim.concealed.study.strength import neighbours
from firmware_sim.physics.effects import Effects

COLUMNS = ("time_s", "voltage_V", "force_N", "temperature_C")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    directory = tmp_path_factory.mktemp("study")
    make(directory, 8, seed=3)
    return directory


def read(path):
    with path.open() as file:
        names = file.readline().strip().split(",")
        return dict(zip(names, np.loadtxt(file, delimiter=",", unpack=True), strict=True))


def test_the_same_seed_makes_the_same_study(study, tmp_path):
    make(tmp_path, 8, seed=3, jobs=2)
    for path in sorted(study.rglob("*")):
        if path.is_file() and path.name != "seal.json":
            assert path.read_bytes() == (tmp_path / path.relative_to(study)).read_bytes(), path


def test_every_third_case_may_begin_amid_its_work(study, tmp_path):
    make(tmp_path, 3, seed=3, amid_s=8.0)
    make(tmp_path / "whole", 3, seed=3)
    for name, begin_s in (("case_0001", 0.0), ("case_0003", 8.0)):
        for path in sorted((tmp_path / name).glob("*.csv")):
            whole, found = read(tmp_path / "whole" / name / path.name), read(path)
            kept = whole["time_s"] >= (begin_s if path.name.startswith("recording") else 0.0)
            assert found["force_N"].tolist() == whole["force_N"][kept].tolist()
    assert "somewhere in the range" in (tmp_path / "case_0003" / "case.json").read_text(encoding="utf-8")


def test_no_seed_makes_another_study_every_time(tmp_path):
    for name in "ab":
        make(tmp_path / name, 1, kind="null")
    paths = [tmp_path / name / "case_0001" / "identification.csv" for name in "ab"]
    assert paths[0].read_bytes() != paths[1].read_bytes()


def test_a_case_has_the_files_that_it_lists_and_no_others(study):
    for folder in study.glob("case_*"):
        content = json.loads((folder / "case.json").read_text())
        names = {content["identification"], *content["recordings"], content["held_out"], "case.json"}
        assert names == {path.name for path in folder.iterdir()}


def test_a_record_starts_at_rest_and_its_time_strictly_increases(study):
    for path in study.glob("case_*/*.csv"):
        record = read(path)
        assert set(record) <= set(COLUMNS)
        assert record["voltage_V"][0] == 0.0
        assert (np.diff(record["time_s"]) > 0).all()
        assert np.isfinite(record["force_N"]).all()


def test_what_an_engineer_is_given_names_no_effect(study):
    for path in study.glob("case_*/case.json"):
        assert not any(name in path.read_text() for name in (*ENTRIES, *FOREIGN))


def test_the_sealed_force_is_the_held_out_record_without_its_noise(study):
    for name, truth in open_truth(study)["cases"].items():
        if truth["kind"] != "null":
            continue
        clean = unpack_arrays((study / "sealed" / f"{name}.sealed").read_bytes())["held_out_true_N"]
        measured = read(study / name / "held_out.csv")["force_N"]
        assert np.std(measured - clean) == pytest.approx(truth["noise"]["rms_N"], rel=0.1)


@pytest.mark.parametrize("victim", ["truth.sealed", "sealed/case_0002.sealed"])
def test_a_seal_that_was_tampered_with_is_refused(tmp_path, victim):
    make(tmp_path, 2, seed=1, kind="null")
    open_truth(tmp_path)
    path = tmp_path / victim
    path.write_bytes(path.read_bytes()[:-4] + b"AAA=")
    with pytest.raises(SealError, match="was sealed as"):
        open_truth(tmp_path)
    path.unlink()
    with pytest.raises(SealError, match="missing"):
        open_truth(tmp_path)


def test_a_study_is_not_overwritten(study):
    with pytest.raises(StudyError, match="has a study already"):
        make(study, 1)
    assert main(["make", str(study), "--cases", "1"]) == 78


def test_a_plan_has_a_quarter_nulls_every_single_evenly_and_every_foreign_effect():
    planned = case_specs(np.random.default_rng(1), 300, "all", None, None)
    counts = {kind: sum(spec.kind == kind for spec in planned) for kind in KINDS}
    assert sum(counts.values()) == 300
    assert counts["null"] >= 75
    assert counts["pair"] == 60
    assert counts["triple"] == 24
    assert counts["foreign"] == 36
    singles = [spec.names[0] for spec in planned if spec.kind == "single"]
    each = [singles.count(name) for name in ENTRIES]
    assert max(each) - min(each) <= 1
    assert {spec.names[0] for spec in planned if spec.kind == "foreign"} == set(FOREIGN)
    assert {noise: sum(spec.noise == noise for spec in planned) > 20 for noise in ("white", "coloured", "quantised")}
    assert all(len(set(spec.names)) == len(spec.names) for spec in planned)


def test_singles_of_an_effect_have_every_strength_in_turn():
    planned = case_specs(np.random.default_rng(1), 66, "single", None, None)
    wanted = {(spec.names[0], spec.strengths[0]) for spec in planned}
    assert len(wanted) == 66


def test_no_foreign_effect_is_mentioned_in_the_daemon():
    sources = [path.read_text() for path in Path(piezod.__file__).parent.rglob("*.py")]
    assert not [name for name in FOREIGN for source in sources if name in source]


def test_an_effect_and_a_strength_that_are_asked_for_are_in_every_case():
    for kind, count in (("single", 1), ("pair", 2), ("triple", 3)):
        for spec in case_specs(np.random.default_rng(1), 20, kind, "creep", 4.0):
            assert spec.names[0] == "creep"
            assert len(spec.names) == count
            assert set(spec.strengths) == {4.0}


def test_the_catalogue_is_the_bench_one_and_foreign_effects_are_not_in_it():
    assert set(ENTRIES) == set(Effects.model_fields)
    assert len(FOREIGN) >= 8
    assert not set(FOREIGN) & set(ENTRIES)


@pytest.mark.parametrize("name", [*ENTRIES, *FOREIGN])
def test_an_effect_is_as_strong_as_the_truth_says(name):
    spec = CaseSpec("foreign" if name in FOREIGN else "single", (name,), (4.0,), "white")
    case = draw_case(spec, np.random.SeedSequence(5))
    truth = case.truth["effects"][0]
    work = case.records[1]

    def reading(effects):
        values = case.plant.reading_N(work.drive, effects, work.seed)
        if "quantisation" in effects:
            values = quantised(values, effects["quantisation"].parameters["step_N"])
        if "sensor_dropout" in effects:
            stretches = [(place["low"], place["high"]) for place in truth["where"]]
            values = frozen(values, work.drive.time_s, stretches)
        return values

    plain = reading({})
    columns = [plain, np.ones(plain.size)]
    if name in FOREIGN:
        columns += list(neighbours(plain, work.drive.rate_Hz).T)
    if truth["scope"] != COME_SINCE or name in FOREIGN:
        widths = work.drive.voltage_V.max() * np.linspace(0.0, 1.0, 30) ** 1.3
        states, rows = np.zeros(30), np.empty((plain.size, 30))
        for k, u in enumerate(work.drive.voltage_V):
            states = np.maximum(u - widths, np.minimum(u + widths, states))
            rows[k] = states
        columns += list(rows.T)
    columns = np.column_stack(columns)
    columns /= np.sqrt((columns**2).mean(axis=0)).clip(1e-9)
    shown = reading(case.effects)
    left = shown - columns @ np.linalg.lstsq(columns, shown, rcond=None)[0]
    strength = np.std(left) / case.noise.rms_N
    assert truth["strength"] in {0.8, 4.0, 20.0}
    assert strength == pytest.approx(truth["strength"], rel=0.12)
    assert case.kind == "null" or set(effects_in(case.effects, "identification.csv")) == (
        {name} if truth["scope"] != COME_SINCE else set()
    )


def test_what_happens_once_is_in_the_first_recording_alone():
    case = draw_case(CaseSpec("single", ("load_step",), (4.0,), "white"), np.random.SeedSequence(1))
    assert not case.active(case.records[0])
    assert set(case.active(case.records[1])) == {"load_step"}
    assert not case.active(case.records[-1])
