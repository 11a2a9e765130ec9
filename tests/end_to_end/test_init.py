"""A bench file made by answers, beside an emulated device that is looked at and never written to."""

import json
import os
import pty
import subprocess
import sys

import pytest

from piezod.commissioning.init import Answers, draft_bench, list_profiles, write_bench
from piezod.config import load_bench
from piezod.errors import ConfigurationError, UsageError
from piezod.transport.probe import serial_ports
from tests.benches.emulator import emulator, piezod


@pytest.fixture(scope="module")
def serves():
    with emulator("--port", "0") as served:
        yield served


def test_a_bench_file_is_made_without_questions_and_passes_the_check(serves, tmp_path):
    host, _, port = serves["tcp"].rpartition(":")
    path = tmp_path / "press.yaml"
    given = ("--profile", "bench", "--name", "press", "--host", host, "--port", port)
    done = piezod("init", "--yes", *given, "-o", path, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["found"]
    assert found[-1] == "identity, map version and byte order: as the profile expects, as far as it names them"
    bench = load_bench(path)
    assert (bench.name, bench.link.port) == ("press", int(port))
    assert "The name of a key contains its unit" in path.read_text(encoding="utf-8")
    checked = piezod("config", "check", path)
    assert checked.returncode == 0
    assert "bench 'press', 1000 Hz over modbus_tcp" in checked.stdout


def test_another_device_is_told_and_nobody_too(serves, tmp_path):
    host, _, port = serves["tcp"].rpartition(":")
    done = piezod("init", "-y", "--profile", "wago_750", "--host", host, "--port", port, "-o", tmp_path / "a.yaml")
    assert done.returncode == 0, done.stderr
    assert "not as the profile expects" in done.stdout
    done = piezod("init", "-y", "--profile", "wago_750", "--host", host, "--port", "1", "-o", tmp_path / "b.yaml")
    assert "127.0.0.1:1: nobody answers" in done.stdout
    assert done.stderr == ""


def test_a_file_that_is_there_is_never_replaced_unless_told_to(tmp_path):
    path = tmp_path / "bench.yaml"
    path.write_text("mine", encoding="utf-8")
    options = ("init", "--yes", "--profile", "labjack_t7", "--no-probe", "-o", path)
    done = piezod(*options)
    assert done.returncode == 2
    assert done.stderr == f"piezod: {path} already exists; name another file with -o, or replace it with --force\n"
    assert path.read_text(encoding="utf-8") == "mine"
    assert piezod(*options, "--force").returncode == 0
    assert load_bench(path).name == "labjack_t7"


def test_a_file_that_came_meanwhile_is_not_replaced_either(tmp_path):
    path = tmp_path / "bench.yaml"
    made = draft_bench("bench", Answers(), path)
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(UsageError, match="is there already"):
        write_bench(made, force=False)
    assert path.read_text(encoding="utf-8") == "mine"
    assert [one.name for one in tmp_path.iterdir()] == ["bench.yaml"]


def test_answers_that_make_no_bench_write_nothing(tmp_path):
    with pytest.raises(ConfigurationError, match=r"force_trip_N is 5000, must be below registers\.force\.high"):
        draft_bench("bench", Answers(force_trip_N=5000.0), tmp_path / "bench.yaml")
    with pytest.raises(UsageError, match="--serial does not belong to this profile"):
        draft_bench("bench", Answers(serial="/dev/ttyS0"), tmp_path / "bench.yaml")
    with pytest.raises(UsageError, match="must be one of advantech_adam_6024, bench"):
        draft_bench("labjack", Answers(), tmp_path / "bench.yaml")


@pytest.mark.parametrize("profile", list_profiles())
def test_every_profile_can_be_taken_as_it_is(profile, tmp_path):
    made = draft_bench(profile, Answers(name="mine"), tmp_path / "bench.yaml")
    assert made.bench.name == "mine"


def test_serial_ports_are_listed_by_their_lasting_names(tmp_path):
    device = tmp_path / "ttyUSB7"
    device.touch()
    folder = tmp_path / "by-id"
    folder.mkdir()
    (folder / "usb-FTDI_A1-if00").symlink_to(device)
    assert str(folder / "usb-FTDI_A1-if00") in [port.path for port in serial_ports(folder)]
    assert str(device) not in [port.path for port in serial_ports(folder)]


def test_questions_are_asked_on_a_terminal_and_the_profile_is_offered(tmp_path):
    path = tmp_path / "bench.yaml"
    answers = ("pi_e625", "stage", "/dev/ttyS9", "", "10", "", "")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "piezod", "init", "--no-probe", "-o", str(path)]
    os.write(ours, "".join(f"{answer}\n" for answer in answers).encode())
    done = subprocess.run(command, stdin=theirs, capture_output=True, text=True, timeout=120, check=False)
    os.close(ours)
    os.close(theirs)
    assert done.returncode == 0, done.stderr
    assert "labjack_t7 " in done.stdout
    assert "name of the bench [pi_e625]" in done.stdout
    bench = load_bench(path)
    assert (bench.name, bench.link.port, bench.rate_Hz) == ("stage", "/dev/ttyS9", 10.0)
