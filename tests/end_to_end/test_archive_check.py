"""The daily check: the newest recorded drive is diagnosed with the model in use, and its answer is seen everywhere."""

import json
from datetime import UTC, datetime

import pytest

from piezod.config import load_bench
from piezod.daemon.last_check import LastCheck, check_text
from piezod.recording import read_recording
from tests.benches.emulator import EMULATOR, ROOT, bench_file, emulator, piezod

LIMITS = {"stale_after_ms": 20, "missed_ticks_in_a_row": 5, "tracking_trip_N": None}
REFERENCE = {"kind": "multisine", "amplitude_N": 100.0, "offset_N": 150.0, "frequency_Hz": 0.25, "duration_s": 30.0}


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A bench that was driven for half a minute, with its recorder."""
    folder = tmp_path_factory.mktemp("driven")
    with emulator("--port", "0", "--time", "virtual", config=EMULATOR) as serves:
        recorder = {"folder": str(folder / "recordings"), "sync_every_s": 0.1}
        bench = bench_file(
            folder, serves, rate_Hz=200, limits=LIMITS, reference=REFERENCE, recorder=recorder, drift={"keep_s": 20}
        )
        done = piezod("run", bench, "--arm")
    assert done.returncode == 0, done.stderr
    return bench, folder / "recordings" / "checks"


def test_without_a_drive_nothing_is_checked(tmp_path):
    (tmp_path / "recordings").mkdir()
    bench = bench_file(tmp_path, {"tcp": "127.0.0.1:1"}, recorder={"folder": str(tmp_path / "recordings")})
    done = piezod("diagnose", "--from-archive", bench, "-o", tmp_path / "checks")
    assert done.returncode == 75
    assert "no drive of 20 s" in done.stderr
    without = bench_file(tmp_path, {"tcp": "127.0.0.1:1"})
    done = piezod("diagnose", "--from-archive", without, "-o", tmp_path / "checks")
    assert done.returncode == 78
    assert "recorder is null" in done.stderr


def test_the_newest_drive_is_diagnosed_once_and_its_answer_is_seen_everywhere(driven):
    bench, checks = driven
    model = (ROOT / "config" / "model.yaml").read_bytes()
    done = piezod("diagnose", "--from-archive", bench, "-o", checks, "--within", 5, timeout=300)
    assert done.returncode == 0, done.stderr
    (folder,) = checks.iterdir()
    findings = json.loads((folder / "findings.json").read_text(encoding="utf-8"))
    assert findings["words"] in done.stdout
    assert (ROOT / "config" / "model.yaml").read_bytes() == model

    stretch = read_recording(folder / "stretch.csv")
    assert stretch.time_s[-1] == pytest.approx(30.0, abs=0.5)  # the reference; at most 60 s are used
    assert folder.name.startswith("emulator-" + stretch.metadata["recorded"][:4])

    again = piezod("diagnose", "--from-archive", bench, "-o", checks)
    assert again.returncode == 75
    assert "checked already" in again.stderr

    shown = LastCheck.of(load_bench(bench)).as_dict()
    assert shown["verdict"] == findings["verdict"]
    since_s = (datetime.now(UTC) - datetime.fromisoformat(shown["drive_utc"])).total_seconds()
    assert shown["age_s"] == pytest.approx(since_s, abs=60.0)  # virtual time has a clock of its own
    assert shown["drive_utc"][:16] in check_text(shown)

    history = piezod("history", checks, "--json")
    assert history.returncode == 0, history.stderr
    assert json.loads(history.stdout)["checks"] == [
        {
            "folder": str(folder),
            "date": shown["drive_utc"],
            "verdict": findings["verdict"],
            "words": findings["words"],
        }
    ]
    assert f"{folder.name}: {findings['words']}" in piezod("history", checks).stdout
