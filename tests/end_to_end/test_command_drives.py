"""A command that drives is a service: it obeys stop, disarm and signals, keeps the account of heat, loses no row."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from piezod.config import load_bench
from piezod.control import State
from piezod.daemon.client import command_and_wait
from piezod.errors import PiezodError, TemporaryError
from piezod.recording import read_csv, read_recording
from piezod.session.heat_file import HeatFile
from tests.benches.daemon import LONG_LIMITS
from tests.benches.emulator import bench_file, emulator, piezod
from tests.benches.processes import Popen

WITHIN_S = 60.0  # however busy the machine is
SEQUENCE = {
    "schema": "piezod.sequence/1",
    "name": "long",
    "steps": [
        {
            "name": "slow",
            "reference": {
                "kind": "triangle",
                "amplitude_N": 40,
                "offset_N": 150,
                "frequency_Hz": 0.1,
                "duration_s": 90,
            },
            "limits": {"rms_error_N": 5.0},
        }
    ],
}


@pytest.fixture
def bench(tmp_path):
    with emulator("--port", "0") as serves:
        yield bench_file(tmp_path, serves, rate_Hz=100, limits=LONG_LIMITS)


def verb_of(name, bench, folder):
    if name == "record":
        return ["record", bench, "--excitation", "constant-triangles", "--frequency", "0.1", "-o", folder / "out.csv"]
    path = folder / "long.yaml"
    path.write_text(yaml.safe_dump(SEQUENCE), encoding="utf-8")
    return ["run", bench, "--sequence", path, "--arm", "-o", folder / "out"]


@contextlib.contextmanager
def driving(name, bench, folder, works_in=None):
    """The command, once 20 ticks and more have followed its reference."""
    command = [sys.executable, "-m", "piezod", *map(str, verb_of(name, bench, folder))]
    process = Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=works_in or folder)
    try:
        deadline_s, first = time.monotonic() + WITHIN_S, None
        while first is None or status_of(bench).get("ticks", 0) < first + 20:
            if first is None and (status := status_of(bench)).get("state") == State.RUNNING.name:
                first = status["ticks"]
            assert time.monotonic() < deadline_s
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.1)
        yield process
    finally:
        process.kill()
        process.communicate(timeout=WITHIN_S)


def status_of(bench):
    with contextlib.suppress(TemporaryError):
        return command_and_wait(load_bench(bench).socket_path, "status", wait=False)
    return {}


def unfinished(folder):
    """Rows that a command has left on the disk."""
    return [*folder.glob("*-unfinished-*/*")]


def last_state(file):
    """State in the last row of a file; None before the first block."""
    with contextlib.suppress(PiezodError):
        return read_recording(file).channel("state")[-1]
    return None


def control_process_of(process):
    """Number of the control process of a command."""
    for child in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="ascii").split():
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    raise AssertionError("there is no control process")


def at_rest(bench):
    return "at rest" in piezod("stop", bench, "--direct").stdout


@pytest.mark.parametrize("name", ["record", pytest.param("sequence", marks=pytest.mark.slow)])
@pytest.mark.parametrize("how", ["stop", "disarm", signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_command_that_drives_ends_at_rest_by_every_way_to_stop_it_and_keeps_its_rows(bench, tmp_path, name, how):
    with driving(name, bench, tmp_path) as process:
        if isinstance(how, str):
            done = piezod(how, bench)
            assert done.returncode == 0, done.stdout + done.stderr
        else:
            process.send_signal(how)
        _, said = process.communicate(timeout=WITHIN_S)
    assert process.returncode in (1, 130), said
    assert at_rest(bench)
    files = [*tmp_path.glob("out.csv"), *tmp_path.glob("out/step_*.csv")]
    assert files
    assert all(read_csv(file).time_s.size >= 20 for file in files)
    assert not unfinished(tmp_path)


@pytest.mark.parametrize("name", ["record", "sequence"])
def test_a_command_that_is_killed_leaves_every_row_to_the_rest_on_the_disk(bench, tmp_path, name):
    with driving(name, bench, tmp_path) as process:
        process.kill()
        deadline_s = time.monotonic() + WITHIN_S
        while not (files := unfinished(tmp_path)) or last_state(files[0]) != State.DISARMED:
            assert time.monotonic() < deadline_s
            time.sleep(0.1)
    (file,) = tmp_path.glob("*-unfinished-*/*.sqlite")
    recording = read_recording(file)
    assert recording.metadata["incomplete"] == "the command that drove was killed"
    assert recording.time_s.size >= 20
    assert at_rest(bench)


def test_a_folder_where_nobody_can_write_costs_no_recording(bench, tmp_path):
    with driving("record", bench, tmp_path, works_in="/proc") as process:
        assert piezod("stop", bench).returncode == 0
        _, said = process.communicate(timeout=WITHIN_S)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert read_csv(tmp_path / "out.csv").time_s.size >= 20


@pytest.mark.parametrize("name", ["record", "sequence"])
def test_a_control_process_that_is_killed_costs_no_row_that_came(bench, tmp_path, name):
    with driving(name, bench, tmp_path) as process:
        os.kill(control_process_of(process), signal.SIGKILL)
        said = "".join(process.communicate(timeout=WITHIN_S))
    assert process.returncode == 1, said
    assert "ended with code -9" in said
    (file,) = [*tmp_path.glob("out.csv"), *tmp_path.glob("out/step_*.csv")]
    assert read_csv(file).time_s.size >= 20
    assert not unfinished(tmp_path)


def test_what_only_a_served_bench_obeys_is_refused_while_a_command_drives(bench, tmp_path):
    with driving("record", bench, tmp_path):
        for command in ("arm", "reset", "reload"):
            with pytest.raises(TemporaryError, match="a command drives this bench"):
                command_and_wait(load_bench(bench).socket_path, command, wait=False)
        assert status_of(bench)["state"] == State.RUNNING.name


def test_the_heat_of_a_drive_counts_for_the_next_one_whoever_drives(bench, tmp_path):
    content = yaml.safe_load(bench.read_text(encoding="utf-8"))
    content["limits"] |= {"dissipation_max_W": 50.0, "dissipation_over_s": 1000.0}
    bench.write_text(yaml.safe_dump(content), encoding="utf-8")
    HeatFile(load_bench(bench)).keep(0.0)
    with driving("record", bench, tmp_path) as process:
        piezod("stop", bench)
        process.communicate(timeout=WITHIN_S)
    kept = json.loads((tmp_path / "ring.heat").read_text(encoding="ascii"))
    assert 0.0 < kept["power_W"] < 50.0
