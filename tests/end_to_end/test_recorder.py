"""The recorder as a process, and in the daemon: killed, without power, with a full disk; what it kept is read and used.

The long forms are `python -m tests.studies.recorder`.
"""

import csv
import os
import shutil
import signal
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from piezod.recorder.recording_files import recording_files
from piezod.recording import read_recording
from tests.benches.daemon import PATIENT, change, daemon
from tests.benches.emulator import ROOT, bench_file, emulator, piezod
from tests.benches.recorded_blocks import read_blocks
from tests.studies import recorder as study
from tests.studies.powercut import cannot_cut, cannot_mount, fill, small_folder


def lines(found):
    found = list(found)
    for line in found:
        if line.skipped:
            pytest.skip(f"{line.what}: {line.skipped}")
    return found


@pytest.mark.slow
def test_no_acknowledged_row_is_lost_when_the_recorder_is_killed_at_any_moment(tmp_path):
    (line,) = lines(study.kills(tmp_path, 5))
    assert line.acknowledged > 0
    assert (line.lost, line.twice, line.wrong, line.failed) == (0, 0, 0, False), line.text()


@pytest.mark.skipif(bool(cannot_cut()), reason=cannot_cut())
def test_no_acknowledged_row_is_lost_when_the_power_is_cut_and_a_cut_does_cost_what_was_not_synced(tmp_path):
    line, unsynced = lines(study.cuts(tmp_path, 3))
    assert line.acknowledged > 0
    assert (line.lost, line.twice, line.wrong, line.failed) == (0, 0, 0, False), line.text()
    assert unsynced.lost > 0


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
@pytest.mark.parametrize("what", ["EIO at every 20th sync", "ENOSPC at every 400th write"])
def test_no_row_is_lost_when_system_calls_fail(tmp_path, monkeypatch, what):
    monkeypatch.setattr(study, "FAULTS", {what: study.FAULTS[what]})
    (line,) = lines(study.faults(tmp_path, 5.0))
    assert line.acknowledged > 0
    assert (line.lost, line.wrong, line.failed) == (0, 0, False), line.text()


@pytest.fixture
def serves():
    with emulator("--port", "0") as served:
        yield served


def recording_bench(place, serves, recordings, **section):
    triangle = {"kind": "triangle", "amplitude_N": 60, "offset_N": 110, "frequency_Hz": 0.5, "duration_s": None}
    return bench_file(
        place,
        serves,
        rate_Hz=200,
        limits=PATIENT,
        arming={"voltage_V_per_s": 800.0},
        reference=triangle | {"at_end": "ramp_down"},
        daemon={"metrics_port": 0},
        recorder={"folder": str(recordings), "sync_every_s": 0.1} | section,
    )


def ticking(service):
    """Wait until commands are heard at once: steps are compiled before the first tick."""
    service.connected()
    service.wait_until(lambda: service.status()["ticks"] > 5, "the first ticks")


def recorder_of(service):
    return service.status()["recorder"]


def test_every_tick_of_the_daemon_is_recorded_and_read_while_it_is_written(serves, tmp_path):
    with daemon(recording_bench(tmp_path, serves, tmp_path / "kept")) as service:
        ticking(service)
        assert service.tell("arm")["state"] == "RUNNING"
        time.sleep(3.0)
        service.wait_until(lambda: recorder_of(service)["rows"] > 600, "600 rows")
        live = Path(recorder_of(service)["file"])
        simulated = piezod(
            "simulate", live, "--model", ROOT / "config" / "model.yaml", "-o", tmp_path / "simulated.csv"
        )
        assert simulated.returncode == 0, simulated.stderr
        said = service.command("status").stdout
        assert "recorded " in said
        assert live.name in said
        assert service.end() == 0
        total = int(next(line for line in service.said if " ticks, " in line).split()[0])
    with (tmp_path / "simulated.csv").open(encoding="utf-8") as file:
        assert sum(not row[0].startswith("#") for row in csv.reader(file)) > 500
    about, blocks, damaged = read_blocks(live)
    rows = np.concatenate([block.rows for block in blocks])
    assert (rows.size, damaged, blocks[0].first) == (total, 0, 0)
    assert (np.diff(rows["tick"]) > 0).all()
    assert {0, 1, 2, 4} <= set(rows["state"]), "the ramp down too"
    assert about.metadata["bench"] == "emulator"
    assert [path.name for path in live.parent.iterdir()] == [live.name]
    recording = read_recording(live)
    assert abs(recording.channel("wall_s")[-1] - time.time()) < 120.0
    running = recording.channel("state") == 2
    assert np.ptp(recording.channel("force_N")[running]) > 50.0
    assert np.corrcoef(recording.channel("voltage_V")[running], recording.channel("force_N")[running])[0, 1] > 0.9


@pytest.mark.slow
def test_a_recorder_that_dies_is_started_again_and_nothing_is_missing_or_twice(serves, tmp_path):
    with daemon(recording_bench(tmp_path, serves, tmp_path / "kept")) as service:
        service.connected()
        for k in range(2):
            service.wait_until(
                lambda k=k: recorder_of(service)["restarts"] == k and recorder_of(service)["rows"], "rows"
            )
            service.wait_until(lambda: not recorder_of(service)["degraded"], "recording")
            before = recorder_of(service)["rows"]
            os.kill(recorder_of(service)["pid"], signal.SIGKILL)
            service.wait_until(lambda before=before: recorder_of(service)["rows"] > before, "going on")
        service.wait_for("recorder degraded: the recorder ended with -9, and is started again; control goes on")
        service.wait_for("recorder goes on: ")
        assert service.end() == 0
        total = int(next(line for line in service.said if " ticks, " in line).split()[0])
    ticks = [
        tick
        for path in recording_files(tmp_path / "kept", "emulator")
        for block in read_blocks(path)[1]
        for tick in block.rows["tick"].tolist()
    ]
    assert len(ticks) == total
    assert ticks == sorted(set(ticks))


@pytest.mark.slow
def test_the_ticks_around_a_fault_have_a_file_of_their_own(serves, tmp_path):
    bench = recording_bench(tmp_path, serves, tmp_path / "kept", keep_around_s=1.0)
    with daemon(bench) as service:
        ticking(service)
        assert service.tell("arm")["state"] == "RUNNING"
        time.sleep(1.5)
        change(bench, "force_trip_N: 360.0", "force_trip_N: 30.0")
        service.tell("reload")
        service.wait_for("FAULT: force above limits.force_trip_N")
        kept = tmp_path / "kept" / "faults" / "emulator-000001.sqlite"
        service.wait_until(kept.exists, "the file of the fault")
        service.tell("reset")
        assert service.end() == 0
    recording = read_recording(kept)
    state = recording.channel("state")
    begin = int(np.flatnonzero(np.isin(state, (4, 5)))[0])
    assert recording.time_s[begin] - recording.time_s[0] == pytest.approx(1.0, abs=0.02)
    assert recording.time_s[-1] - recording.time_s[begin] >= 0.9
    assert set(state[:begin]) == {2.0}
    assert state[-1] == 5
    assert recording.metadata["kept"] == "around a fault"


@pytest.mark.slow
def test_a_disk_that_does_not_answer_is_said_and_costs_nothing(serves, tmp_path):
    with daemon(recording_bench(tmp_path, serves, tmp_path / "kept")) as service:
        ticking(service)
        assert service.tell("arm")["state"] == "RUNNING"
        service.wait_until(lambda: recorder_of(service)["rows"] > 0, "rows")
        os.kill(recorder_of(service)["pid"], signal.SIGSTOP)  # as a sync that does not come back
        service.wait_until(lambda: "the disk has not answered for" in recorder_of(service)["problem"], "degraded")
        metrics = fetch(service)
        assert 'piezod_recorder_degraded{bench="emulator"} 1.0' in metrics
        ticks = service.status()["ticks"]
        time.sleep(1.0)
        assert service.status()["state"] == "RUNNING"
        assert service.status()["ticks"] - ticks > 50
        os.kill(recorder_of(service)["pid"], signal.SIGCONT)
        service.wait_until(lambda: not recorder_of(service)["degraded"], "going on")
        metrics = fetch(service)
        assert 'piezod_recorder_degraded{bench="emulator"} 0.0' in metrics
        assert 'piezod_recorder_dropped_total{bench="emulator"} 0.0' in metrics
        assert service.end() == 0
    assert sum("recorder degraded: " in line for line in service.said) == 1, "said once, not every second"


def fetch(service):
    address = next(line for line in service.said if line.startswith("metrics: ")).split()[1]
    with urllib.request.urlopen(address, timeout=10) as answer:
        return answer.read().decode()


@pytest.mark.slow
@pytest.mark.skipif(bool(cannot_mount()), reason=cannot_mount())
def test_a_full_disk_is_said_costs_no_tick_and_no_row_and_is_left_when_there_is_room(serves, tmp_path):
    with (
        small_folder(tmp_path / "small", 32.0) as small,
        daemon(recording_bench(tmp_path, serves, small / "kept", file_MB=8, folder_MB=16)) as service,
    ):
        ticking(service)
        assert service.tell("arm")["state"] == "RUNNING"
        service.wait_until(lambda: recorder_of(service)["rows"] > 100, "100 rows")
        ballast = fill(small)
        service.wait_until(lambda: recorder_of(service)["degraded"], "a full disk")
        ticks, kept = service.status()["ticks"], recorder_of(service)["rows"]
        time.sleep(2.0)
        status = service.status()
        assert status["state"] == "RUNNING"
        assert status["ticks"] - ticks > 100
        assert status["recorder"]["problem"].startswith(str(small))
        assert "recorder DEGRADED: " in service.command("status").stdout
        ballast.unlink()
        service.wait_until(lambda: not recorder_of(service)["degraded"], "recovery")
        service.wait_until(lambda: recorder_of(service)["rows"] > kept + 300, "the rows that waited")
        assert recorder_of(service)["dropped"] == 0
        assert service.end() == 0
        total = int(next(line for line in service.said if " ticks, " in line).split()[0])
        found = {
            tick
            for path in recording_files(small / "kept", "emulator")
            for block in read_blocks(path)[1]
            for tick in block.rows["tick"].tolist()
        }
        assert len(found) == total


def test_a_folder_that_is_no_folder_stops_neither_start_nor_control_and_is_one_line_of_check(serves, tmp_path):
    (tmp_path / "kept").write_text("in the way", encoding="utf-8")
    bench = recording_bench(tmp_path, serves, tmp_path / "kept")
    done = piezod("check", bench)
    assert done.returncode == 1
    assert f"FAIL  recorder: recorder.folder is {tmp_path / 'kept'}: " in done.stdout
    with daemon(bench) as service:
        ticking(service)
        service.wait_until(lambda: recorder_of(service)["degraded"], "degraded")
        assert service.tell("arm")["state"] == "RUNNING"
        (tmp_path / "kept").unlink()
        service.wait_until(lambda: recorder_of(service)["rows"] > 0, "rows")
        assert recorder_of(service)["dropped"] == 0
        assert service.end() == 0


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({"folder": ""}, "recorder.folder"),
        ({"file_MB": 9.0, "folder_MB": 17.0}, "must be at least two files of file_MB, 18"),
        ({"sync_every_s": 20.0}, "daemon.ring_seconds is 60, must be at least four times recorder.sync_every_s, 80"),
        ({"folders": "x"}, "did you mean 'folder'?"),
        ({"file_MB": 1.0}, "recorder.file_MB is 1.0, must be at least 8"),
    ],
)
def test_what_a_recorder_cannot_be_is_refused_in_one_line(tmp_path, section, says):
    bench = recording_bench(tmp_path, {"tcp": "127.0.0.1:2"}, tmp_path, **section)
    done = piezod("check", bench)
    assert done.returncode == 1, done.stderr
    assert says in done.stdout
