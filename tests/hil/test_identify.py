"""From the bench to a model and back: recorded, identified, simulated and driven, as commands."""

import json

import numpy as np
import pytest
from hil.emulator import bench_file, emulator, piezod

from piezod.model import load_model
from piezod.recording import Recording, read_csv, write_csv


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("identify")
    with emulator("--time", "virtual", "--port", "0") as serves:
        bench = bench_file(folder, serves, rate_Hz=200, limits={"stale_after_ms": 20}, model="none.yaml")
        done = piezod(
            "record",
            bench,
            "--excitation",
            "varying-triangles",
            "--frequency",
            0.2,
            "--periods",
            15,
            "-o",
            folder / "rec.csv",
        )
    assert done.returncode == 0, done.stderr
    return folder / "rec.csv"


def test_a_bench_without_a_model_is_recorded_identified_and_simulated_down_to_its_noise(recorded, tmp_path):
    model = tmp_path / "model.yaml"
    done = piezod("identify", recorded, "-o", model, "--report", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["held_out"]["rms"] < 0.15
    assert figures["fit"]["rms"] < 0.15
    assert "max hysteresis" in (tmp_path / "identification.html").read_text(encoding="utf-8")
    assert load_model(model).provenance.recordings[0].samples == 15_000
    out = tmp_path / "out.csv"
    done = piezod("simulate", recorded, "--model", model, "-o", out)
    assert done.returncode == 0, done.stderr
    simulated, measured = read_csv(out).channel("force_N"), read_csv(recorded).channel("force_N")
    assert np.sqrt(np.mean((simulated - measured) ** 2)) < 0.15


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (lambda u, y: {"voltage_V": u, "force_N": np.full(u.size, 3.0)}, 78, "force_N is constant at 3"),
        (lambda u, y: {"voltage_V": u * 0 + 5.0, "force_N": y}, 78, "voltage_V is constant at 5"),
        (lambda u, y: {"voltage_V": u, "force_N": -y}, 78, "check the sensor's sign"),
        (lambda u, y: {"voltage_V": u}, 78, "has no column force_N, has voltage_V"),
    ],
)
def test_a_recording_that_tells_nothing_leaves_no_model_behind(recorded, tmp_path, change, code, says):
    source = read_csv(recorded)
    bad = Recording(source.time_s, change(source.channel("voltage_V"), source.channel("force_N")))
    write_csv(bad, tmp_path / "bad.csv")
    done = piezod("identify", tmp_path / "bad.csv", "-o", tmp_path / "model.yaml")
    assert done.returncode == code
    assert len(done.stderr.strip().splitlines()) == 1
    assert says in done.stderr
    assert not (tmp_path / "model.yaml").exists()
