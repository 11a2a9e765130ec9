"""A bench that leaves its model is noticed while it runs, kept, and diagnosed; another model comes in only disarmed."""

import json
import time

import pytest
import yaml

from tests.benches.daemon import daemon
from tests.benches.emulator import EMULATOR, ROOT, bench_file, emulator, piezod

LIMITS = {"stale_after_ms": 20, "missed_ticks_in_a_row": 5, "tracking_trip_N": None}
REFERENCE = {"kind": "multisine", "amplitude_N": 100.0, "offset_N": 150.0, "frequency_Hz": 0.25, "duration_s": 40.0}
CHANGED = {"output_nonlinearity": {"curvature": 0.05}}


def emulated(folder, effects):
    content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8")) | {"seed": 3, "effects": effects}
    path = folder / "emulator.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def ran(folder, effects):
    """One reference on a bench in virtual time: what the run says, and its bench file."""
    folder.mkdir()
    with emulator("--port", "0", "--time", "virtual", config=emulated(folder, effects)) as serves:
        bench = bench_file(
            folder, serves, rate_Hz=200, limits=LIMITS, reference=REFERENCE, drift={"window_s": 5, "keep_s": 60}
        )
        done = piezod("run", bench, "--arm", "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["drift"], bench, done.stderr


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """A bench whose force law has changed since its model was identified."""
    return ran(tmp_path_factory.mktemp("left") / "run", CHANGED)


def test_a_bench_that_is_as_its_model_says_has_not_drifted(tmp_path):
    drift, bench, said = ran(tmp_path / "run", {})
    assert drift["windows"] >= 7
    assert not drift["drifted"]
    assert drift["rms_N"] < drift["limit_N"]
    assert "drift:" not in said
    done = piezod("diagnose", "--from-bench", bench, "-o", tmp_path / "out")
    assert done.returncode == 1
    assert "this bench has not left its model" in done.stderr


def test_a_changed_bench_is_noticed_said_once_and_kept(left):
    drift, bench, said = left
    assert drift["drifted"]
    assert max(drift["rms_N"], abs(drift["offset_N"])) > drift["limit_N"]
    assert said.count("drift: force ") == 1
    rows = (bench.parent / "ring.drift.csv").read_text(encoding="utf-8").splitlines()
    assert 30.0 * 200 < len(rows) < 62.0 * 200


@pytest.mark.slow
def test_what_was_kept_is_diagnosed_with_the_model_of_the_bench(left, tmp_path):
    _, bench, _ = left
    done = piezod("diagnose", "--from-bench", bench, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    findings = json.loads((tmp_path / "out" / "findings.json").read_text(encoding="utf-8"))
    assert findings["effects"][0]["name"] == "output_nonlinearity"
    assert findings["effects"][0]["parameters"]["curvature"]["value"] == pytest.approx(0.05, rel=0.15)
    proposed = yaml.safe_load((tmp_path / "out" / "model.yaml").read_text(encoding="utf-8"))
    assert [one["name"] for one in proposed["effects"]] == [one["name"] for one in findings["effects"]]
    assert "piezod disarm" in done.stdout


def test_status_tells_of_the_model_and_another_model_comes_in_only_when_disarmed(tmp_path):
    with emulator("--port", "0") as serves:
        limits = {"comm_loss_ms": 2000, "device_watchdog_ms": 1000, "missed_ticks_in_a_row": 100}
        bench = bench_file(
            tmp_path, serves, rate_Hz=200, limits=limits, arming={"voltage_V_per_s": 800.0}, drift={"window_s": 1}
        )
        model = (ROOT / "config" / "model.yaml").read_text(encoding="utf-8")
        (tmp_path / "model.yaml").write_text(model, encoding="utf-8")
        bench.write_text(bench.read_text().replace(str(ROOT / "config" / "model.yaml"), "model.yaml"))
        with daemon(bench) as service:
            service.connected()
            service.command("arm", "--json")
            service.wait_until(lambda: (service.status()["drift"] or {}).get("windows", 0) > 0, "the first window")
            status = service.status()
            assert not status["drift"]["drifted"]
            assert abs(status["corrected_force_N"] - status["force_N"]) < 30.0
            assert "model: holds" in service.command("status").stdout
            (tmp_path / "model.yaml").write_text(model.replace("name:", "name: other #", 1), encoding="utf-8")
            refused = service.command("reload")
            assert refused.returncode == 1
            assert "disarm first" in refused.stderr
            service.command("disarm")
            assert service.command("reload").returncode == 0
            time.sleep(0.5)
            service.wait_until(lambda: service.status()["connected"], "the next session")
            assert service.status()["state"] == "DISARMED"
