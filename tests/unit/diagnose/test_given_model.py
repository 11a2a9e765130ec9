"""The circle: a diagnosis starts from the given model, whole, and what it says is what simulation of its model does."""

import json
import shutil
from functools import partial

import numpy as np
import pytest

import piezod
from piezod.diagnose.command import diagnose_files
from piezod.estimation.recordings import preparation
from piezod.model import load_model, save_model
from piezod.model.parameters import EffectValues
from piezod.recording import write_csv
from tests.benches.plain_stack import NOISE_N, record, triangles, work

HARMONICS = [f"{wave}_{h}" for h in range(2, 8) for wave in ("sine", "cosine")]
OLD = {"creep_per_decade": 0.013, "late": 3}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the model of a bench that creeps and is late, and has been diagnosed."""
    folder = tmp_path_factory.mktemp("bench")
    peaks_V = [100, 40, 80, 60, 100, 30, 90, 70, 50, 20]
    identified = piezod.identify(str(record(folder / "identification.csv", triangles(peaks_V), 1)))
    identified.model.save(folder / "identified.yaml")
    record(folder / "work.csv", work(3), 2, **OLD)
    diagnosed(folder, folder / "identified.yaml", "work", folder / "first")
    shutil.copy(folder / "first" / "model.yaml", folder / "model.yaml")
    return folder


def diagnosed(folder, model, name, out):
    diagnose_files([folder / f"{name}.csv"], model, out, None, None, lambda *_: None)
    return json.loads((out / "findings.json").read_text(encoding="utf-8"))


def later(bench, tmp_path, **state):
    """Findings of one more recording of the bench, and the written model."""
    record(tmp_path / "later.csv", work(4), 5, **{**OLD, **state})
    shutil.copy(bench / "model.yaml", tmp_path / "model.yaml")
    shutil.copy(bench / "identification.csv", tmp_path / "identification.csv")
    findings = diagnosed(tmp_path, tmp_path / "model.yaml", "later", tmp_path / "out")
    return findings, load_model(tmp_path / "out" / "model.yaml")


def without_older_recordings(model):
    """The model as it stands for its recordings when they are gone."""
    gone = tuple(entry.model_copy(update={"path": "gone.csv"}) for entry in model.provenance.recordings)
    provenance = model.provenance.model_copy(update={"recordings": gone})
    return model.model_copy(update={"provenance": provenance})


def tared_rms(path, model):
    """Error of a simulation after its first second, about its mean."""
    measured = piezod.read_recording(path)
    error = measured.channel("force_N") - piezod.simulate(path, model).channel("force_N")
    return np.std(error[measured.time_s >= 1.0])


def names(effects):
    return {one["name"]: one.get("status") for one in effects}


def test_the_errors_told_are_those_of_simulating_the_given_and_the_written_model(bench):
    findings = json.loads((bench / "first" / "findings.json").read_text(encoding="utf-8"))
    assert names(findings["effects"]) == {"creep": "new", "transport_delay": "new"}
    told = findings["fit"]["held_out"]
    assert told["before"] == pytest.approx(tared_rms(bench / "work.csv", bench / "identified.yaml"), rel=1e-9)
    assert told["after"] == pytest.approx(tared_rms(bench / "work.csv", bench / "model.yaml"), rel=1e-9)


def test_a_model_with_effects_matches_a_bench_on_which_nothing_has_changed(bench, tmp_path):
    findings, model = later(bench, tmp_path)
    assert findings["verdict"] == "matches"
    assert findings["effects"] == []
    assert {one["name"]: one["seen"] for one in findings["kept"]} == {"creep": True, "transport_delay": True}
    assert findings["base"]["status"] == "kept"
    given = tared_rms(tmp_path / "later.csv", bench / "model.yaml")
    assert findings["fit"]["held_out"]["before"] == pytest.approx(given, rel=1e-9)
    assert model == load_model(bench / "model.yaml")


def test_without_older_recordings_a_changed_effect_leaves_the_hysteresis_as_it_is(bench, tmp_path):
    given = without_older_recordings(load_model(bench / "model.yaml"))
    save_model(given, tmp_path / "model.yaml")
    record(tmp_path / "later.csv", work(4), 5, **{**OLD, "creep_per_decade": 0.02})
    findings = diagnosed(tmp_path, tmp_path / "model.yaml", "later", tmp_path / "out")
    assert names(findings["effects"]) == {"creep": "changed"}
    assert findings["verdict"] == "explained"
    assert load_model(tmp_path / "out" / "model.yaml").hysteresis == given.hysteresis


def test_without_older_recordings_a_changed_gain_scales_the_hysteresis(bench, tmp_path):
    given = without_older_recordings(load_model(bench / "model.yaml"))
    save_model(given, tmp_path / "model.yaml")
    record(tmp_path / "later.csv", work(4), 5, **OLD, gain=1.04)
    findings = diagnosed(tmp_path, tmp_path / "model.yaml", "later", tmp_path / "out")
    assert findings["base"]["status"] == "changed"
    drive_V = triangles([100, 40, 80])
    before, after = (
        model.hysteresis.operator().run(drive_V) for model in (given, load_model(tmp_path / "out" / "model.yaml"))
    )
    slope = np.polyfit(before, after, 1)[0]
    assert slope == pytest.approx(1.04, rel=5e-3)
    assert np.std(after - slope * before) < 2e-3 * np.ptp(after)  # the same loops


def test_the_errors_of_a_long_recording_are_of_all_its_samples(bench, tmp_path, monkeypatch):
    monkeypatch.setattr(preparation, "MOST_SAMPLES", 4000)
    findings, _ = later(bench, tmp_path)
    assert findings["verdict"] == "matches"
    assert any("later.csv: has 6000 samples; effects are looked for in 4000" in note for note in findings["notes"])
    given = tared_rms(tmp_path / "later.csv", bench / "model.yaml")
    assert findings["fit"]["held_out"]["before"] == pytest.approx(given, rel=1e-9)


def test_an_unchanged_bench_begins_no_search_and_a_changed_one_does(bench, tmp_path):
    save_model(without_older_recordings(load_model(bench / "model.yaml")), tmp_path / "model.yaml")
    for name, state, is_searched in (("same", {}, False), ("later", {"late": 4}, True)):
        path, steps = record(tmp_path / f"{name}.csv", work(4), 5, **{**OLD, **state}), []
        on_step = partial(lambda known, step, _: known.append(step), steps)
        diagnose_files([path], tmp_path / "model.yaml", tmp_path / name, None, None, on_step)
        assert any(step.startswith("looking for effect") for step in steps) == is_searched


def test_sizes_by_one_recording_alone_follow_a_bench_that_changes_below_the_threshold(bench, tmp_path):
    """Beside the same work on the bench as it was: the errors of base and form are alike in both."""

    def own(name, **state):
        (tmp_path / name).mkdir()
        findings, _ = later(bench, tmp_path / name, **state)
        creep = next(one for one in findings["kept"] if one["name"] == "creep")["measured"]["per_decade"]
        return creep, findings["base"]["measured"]["gain"]

    (creep, gain), (grown, same), (_, higher) = own("same"), own("grown", creep_per_decade=0.0143), own("up", gain=1.02)
    assert grown["value"] / creep["value"] == pytest.approx(1.10, abs=0.04)
    assert grown["low"] < grown["value"] < grown["high"]
    assert same["value"] / gain["value"] == pytest.approx(1.0, abs=2e-3)
    assert higher["value"] / gain["value"] == pytest.approx(1.02, abs=2e-3)


@pytest.mark.parametrize(("hum_N", "status"), [(0.0, {"mains_hum": "gone"}), (0.5, {})])
def test_a_hum_of_the_given_model_that_is_not_there_is_gone(bench, tmp_path, hum_N, status):
    model = load_model(bench / "model.yaml")
    hum = EffectValues(
        name="mains_hum",
        parameters={"amplitude_N": 0.5, "frequency_Hz": 50.0, "phase_rad": 0.0, **dict.fromkeys(HARMONICS, 0.0)},
        intervals={"amplitude_N": (0.49, 0.51), "frequency_Hz": (49.99, 50.01)},
        recording="0" * 64,
    )
    save_model(model.model_copy(update={"effects": (*model.effects, hum)}), tmp_path / "model.yaml")
    record(tmp_path / "later.csv", work(4), 5, **OLD, hum_N=hum_N)
    findings = diagnosed(tmp_path, tmp_path / "model.yaml", "later", tmp_path / "out")
    assert names(findings["effects"]) == status
    written = {effect.name for effect in load_model(tmp_path / "out" / "model.yaml").effects}
    assert ("mains_hum" in written) == (hum_N > 0.0)


@pytest.mark.slow
def test_an_effect_that_has_grown_is_told_from_and_to(bench, tmp_path):
    findings, model = later(bench, tmp_path, late=6)
    assert names(findings["effects"]) == {"transport_delay": "changed"}
    delay_s = findings["effects"][0]["parameters"]["delay_s"]
    assert delay_s["was"]["value"] == pytest.approx(0.015, abs=0.0025)
    assert delay_s["value"] == pytest.approx(0.030, abs=0.0025)
    assert names(findings["kept"]) == {"creep": None}
    written = {one.name: one for one in model.effects}
    assert set(written) == {"creep", "transport_delay"}
    assert written["creep"] == next(one for one in load_model(bench / "model.yaml").effects if one.name == "creep")


def less_known(information, name, factor):
    """Information in which the errors of an effect are larger by a factor; root R becomes R D."""
    scale = [1.0 / factor if row.startswith(f"{name}.") else 1.0 for row in information.names]
    root = tuple(tuple(np.multiply(row, scale[k:]).tolist()) for k, row in enumerate(information.root))
    return information.model_copy(update={"root": root})


@pytest.mark.parametrize(("factor", "status"), [(1.0, "changed"), (1e3, "kept")])
def test_a_value_that_older_recordings_did_not_determine_is_averaged_and_has_not_changed(
    bench,
    tmp_path,
    factor,
    status,
):
    model = load_model(bench / "model.yaml")
    information = less_known(model.information, "creep", factor)
    save_model(model.model_copy(update={"information": information}), tmp_path / "model.yaml")
    record(tmp_path / "later.csv", work(4), 5, creep_per_decade=0.026, late=3)
    findings = diagnosed(tmp_path, tmp_path / "model.yaml", "later", tmp_path / "out")
    kept = {one["name"]: "kept" for one in findings["kept"] if one["seen"]}
    assert (kept | names(findings["effects"]))["creep"] == status
    written = {effect.name: effect for effect in load_model(tmp_path / "out" / "model.yaml").effects}
    assert written["creep"].parameters["per_decade"] == pytest.approx(0.026, rel=0.1)
    since = next(effect.since for effect in model.effects if effect.name == "creep")
    assert (written["creep"].since == since) == (status == "kept")


def test_a_new_drift_is_not_taken_for_a_change_of_the_known_creep(bench, tmp_path):
    save_model(without_older_recordings(load_model(bench / "model.yaml")), tmp_path / "model.yaml")
    later = piezod.read_recording(record(tmp_path / "plain.csv", work(4), 5, **OLD))
    temperature_C = 20.0 + 2.0 * np.sin(2.0 * np.pi * later.time_s / later.time_s[-1])
    force_N = later.channel("force_N") - 1.5 * (temperature_C - 20.0)
    channels = {"voltage_V": later.channel("voltage_V"), "force_N": force_N, "temperature_C": temperature_C}
    write_csv(piezod.Recording(later.time_s, channels), tmp_path / "later.csv")
    findings = diagnosed(tmp_path, tmp_path / "model.yaml", "later", tmp_path / "out")
    assert names(findings["effects"]) == {"thermal_drift": "new"}
    assert findings["effects"][0]["parameters"]["coefficient_N_per_K"]["value"] == pytest.approx(-1.5, rel=0.05)
    assert {one["name"] for one in findings["kept"]} == {"creep", "transport_delay"}


@pytest.mark.slow
def test_an_effect_that_is_gone_leaves_the_model(bench, tmp_path):
    findings, model = later(bench, tmp_path, creep_per_decade=0.0)
    assert names(findings["effects"]) == {"creep": "gone"}
    assert [one.name for one in model.effects] == ["transport_delay"]
    assert tared_rms(tmp_path / "later.csv", tmp_path / "out" / "model.yaml") < 1.1 * NOISE_N


@pytest.mark.slow
def test_a_stack_that_has_lost_gain_is_a_change_of_the_base_and_no_effect(bench, tmp_path):
    findings, model = later(bench, tmp_path, gain=0.96)
    assert findings["effects"] == []
    assert findings["base"]["status"] == "changed"
    gain = findings["base"]["gain"]
    assert gain["low"] < gain["value"] < gain["high"]
    assert gain["value"] == pytest.approx(0.96, abs=0.002)
    assert {one.name for one in model.effects} == {"creep", "transport_delay"}
    assert tared_rms(tmp_path / "later.csv", tmp_path / "out" / "model.yaml") < 1.2 * NOISE_N
