"""From the bench to a model and back: recorded, identified, simulated and driven, as commands."""

import hashlib
import json
import signal

import numpy as np
import pytest

from piezod.commissioning.record import record_excitation
from piezod.control import State
from piezod.excitation import IDENTIFICATION, duration_s
from piezod.model import load_model
from piezod.recording import Recording, read_csv, read_recording, write_csv
from piezod.recording.files import convert
from tests.benches.emulator import ROOT, bench_file, emulator, piezod


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


@pytest.mark.parametrize(("suffix", "back"), [(".h5", ".mat"), (".parquet", ".csv"), (".mf4", ".tdms")])
def test_every_format_goes_in_and_comes_out(recorded, tmp_path, suffix, back):
    copy, model, out = tmp_path / f"rec{suffix}", tmp_path / "model.yaml", tmp_path / f"out{back}"
    convert(recorded, copy)
    done = piezod("identify", copy, "-o", model, "--plays", 8, "--dead-zones", 2, "--json")
    assert done.returncode == 0, done.stderr
    done = piezod("simulate", copy, "--model", model, "-o", out, "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["recording"] == {
        "path": str(copy),
        "sha256": hashlib.sha256(copy.read_bytes()).hexdigest(),
        "samples": 15_000,
        "read_as": None,
    }
    simulated, measured = read_recording(out), read_recording(recorded)
    assert list(simulated.channels) == ["force_N"]
    np.testing.assert_allclose(simulated.time_s, measured.time_s, rtol=0, atol=1e-9)
    error_N = (simulated.channel("force_N") - measured.channel("force_N"))[simulated.time_s >= 1.0]
    assert figures["compared"]["rms"] == pytest.approx(np.sqrt(np.mean(error_N**2)), rel=1e-6)
    assert figures["compared"]["rms"] < 0.01 * np.ptp(measured.channel("force_N"))


def test_a_bench_records_into_any_format_and_repeats_what_tells_all_in_one_run_once(tmp_path):
    with emulator("--time", "virtual", "--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=100, limits={"stale_after_ms": 20}, model="none.yaml")
        options = ["--excitation", IDENTIFICATION, "--frequency", 2, "-o", tmp_path / "rec.h5"]
        done = piezod("record", bench, *options)
    assert done.returncode == 0, done.stderr
    recording = read_recording(tmp_path / "rec.h5")
    assert recording.metadata["excitation"].endswith(" 1 periods")
    assert recording.time_s[-1] == pytest.approx(duration_s(IDENTIFICATION, 2.0, 1), abs=0.05)


def test_the_voltage_of_a_recording_is_driven_again_scaled_and_repeated(tmp_path):
    time_s = np.arange(200) / 100.0
    drive_V = 40.0 * np.sin(2 * np.pi * time_s) ** 2
    write_csv(Recording(time_s, {"voltage_V": drive_V}), tmp_path / "drive.csv")
    with emulator("--time", "virtual", "--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=100, limits={"stale_after_ms": 20}, model="none.yaml")
        again = ["--excitation", tmp_path / "drive.csv", "--peak", 80, "--periods", 2, "-o", tmp_path / "rec.csv"]
        done = piezod("record", bench, *again)
        too_high = piezod("record", bench, *again[:2], "--peak", 200, *again[4:-1], tmp_path / "high.csv")
    assert done.returncode == 0, done.stderr
    driven_V = read_csv(tmp_path / "rec.csv").channel("voltage_V")
    np.testing.assert_allclose(driven_V, np.tile(2.0 * drive_V, 2)[: driven_V.size], atol=1e-3)
    assert driven_V.size >= 2 * drive_V.size - 2
    assert (too_high.returncode, too_high.stderr.count("\n")) == (2, 1)
    assert "at most 140 V" in too_high.stderr


@pytest.mark.parametrize("command", ["identify", "simulate"])
def test_a_result_never_overwrites_the_recording(recorded, tmp_path, command):
    copy = tmp_path / "rec.csv"
    copy.write_bytes(recorded.read_bytes())
    model = ["--model", ROOT / "config" / "model.yaml"] if command == "simulate" else []
    done = piezod(command, copy, *model, "-o", copy)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "which is a recording that is read" in done.stderr
    assert copy.read_bytes() == recorded.read_bytes()


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (lambda u, y: {"voltage_V": u, "force_N": np.full(u.size, 3.0)}, 78, "force_N is constant at 3"),
        (lambda u, y: {"voltage_V": u * 0 + 5.0, "force_N": y}, 78, "voltage_V is constant at 5"),
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


def test_ctrl_c_ramps_down_and_marks_the_recording_as_incomplete(tmp_path):
    running = []

    def interrupt(rows):
        running.extend(rows[rows["state"] == State.RUNNING])
        if len(running) > 100:
            signal.raise_signal(signal.SIGINT)

    with emulator("--time", "virtual", "--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=100, limits={"stale_after_ms": 20}, model="none.yaml")
        about = {"peak_V": 80.0, "frequency_Hz": 0.1, "periods": 20, "reset_cycle": False, "on_rows": interrupt}
        recording, outcome = record_excitation(bench, "constant-triangles", **about)
    assert outcome.stopped
    assert recording.metadata["incomplete"].startswith("stopped by the user, after ")
    assert recording.metadata["incomplete"].endswith(" of 200.0 s")
    assert 0.5 < recording.time_s[-1] < 199.0
