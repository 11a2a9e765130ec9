"""The study of compensation in its short form: what was diagnosed on the emulated bench drives it better."""

import json
import subprocess
import sys

import pytest
import yaml

from firmware_sim.physics.scenario import load_scenario
from piezod.config.reference import WaveformReference
from piezod.model import load_model
from tests.benches.emulator import EMULATOR, ROOT, bench_file, emulator, piezod
from tests.studies.driven import follow, study_bench

MODEL = ROOT / "config" / "model.yaml"


@pytest.mark.slow
def test_hidden_creep_lag_and_delay_are_compensated_by_what_the_diagnosis_found(tmp_path):
    command = [sys.executable, "-m", "tests.studies", "compensation", "--short", "--rates", "250"]
    done = subprocess.run(
        [*command, "--json", tmp_path / "rows.json"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    assert not [row["why"] for row in rows if row["why"]]
    rms = {(row["reference"], row["compensation"]): row["rms"] for row in rows}
    for reference in ("triangle 0.1 Hz", "triangle 1 Hz", "multisine 0.25 to 3.25 Hz"):
        assert rms[reference, "extended inverse"] < 0.6 * rms[reference, "static inverse"]
        assert rms[reference, "static inverse"] < 0.5 * rms[reference, "plain gain"]
        assert rms[reference, "floor"] < rms[reference, "extended inverse"]
    assert "extended inverse at 0.1 and 1 Hz" in done.stdout


def test_a_run_within_one_process_is_the_run_over_the_link(tmp_path):
    """The study drives loop and device without a socket: `piezod run` on the same bench measures the same error."""
    rate_Hz, seed = 200.0, 5
    reference = {"kind": "triangle", "amplitude_N": 60.0, "offset_N": 120.0, "frequency_Hz": 0.5, "duration_s": 4.0}
    content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8")) | {"seed": seed, "effects": {"creep": True}}
    (tmp_path / "emulator.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with emulator("--port", "0", "--time", "virtual", config=tmp_path / "emulator.yaml") as serves:
        limits = {"stale_after_ms": 20, "missed_ticks_in_a_row": 5}
        bench = bench_file(tmp_path, serves, rate_Hz=rate_Hz, limits=limits, reference=reference)
        done = piezod("run", bench, "--arm", "--json")
    assert done.returncode == 0, done.stderr
    over_link = json.loads(done.stdout)["tracking"]
    scenario = load_scenario("stack", {"effects": {"creep": {}}})
    followed = follow(
        scenario, seed, study_bench(rate_Hz), load_model(MODEL), "inverse", WaveformReference(**reference)
    )
    rms, _ = followed.error_percent(followed.reading_N)
    assert rms == pytest.approx(100.0 * over_link["rms_error_N"] / followed.range_N, rel=0.03)
    assert followed.reference_N.size == pytest.approx(over_link["ticks"], abs=2)
