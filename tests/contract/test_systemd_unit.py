"""The unit file: what systemd itself says of it, and what the daemon promises to it."""

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from typer.main import get_command

from piezod.cli import app

UNIT = Path(__file__).parents[2] / "systemd" / "piezod.service"
MOST_EXPOSURE = 2.0
analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


@pytest.fixture(scope="module")
def service():
    """The [Service] section; keys that stand several times have several lines."""

    class Repeated(dict):
        def __setitem__(self, key, value):
            super().__setitem__(key, [*self[key], *value] if key in self and isinstance(value, list) else value)

    parser = configparser.ConfigParser(dict_type=Repeated, strict=False, interpolation=None)
    parser.optionxform = str
    parser.read(UNIT, encoding="utf-8")
    return {key: value.splitlines() for key, value in parser["Service"].items()}


def told(*arguments):
    return subprocess.run(["systemd-analyze", *map(str, arguments)], capture_output=True, text=True, check=False)


@analyze
def test_systemd_finds_nothing_to_say():
    done = told("verify", UNIT)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == ""


@analyze
def test_the_exposure_is_at_most_two():
    done = told("security", "--offline=true", f"--threshold={round(10 * MOST_EXPOSURE)}", UNIT)
    overall = re.search(r"Overall exposure level for piezod\.service: ([0-9.]+)", done.stdout)
    print(overall.group(0))
    assert float(overall.group(1)) <= MOST_EXPOSURE
    assert done.returncode == 0


def test_a_start_never_arms(service):
    assert all("--arm" not in line for key in ("ExecStart", "ExecReload", "ExecStopPost") for line in service[key])


def test_every_command_it_starts_is_one_of_ours(service):
    verbs = set(get_command(app).commands)
    for key in ("ExecStart", "ExecStopPost"):
        for verb in re.findall(r"\bpiezod (\w+)", " ".join(service[key])):
            assert verb in verbs


def test_ready_and_watchdog_are_the_daemons_and_a_stop_may_take_a_ramp(service):
    assert service["Type"] == ["notify"]
    assert 1 <= int(service["WatchdogSec"][0]) <= 10
    assert int(service["TimeoutStopSec"][0]) >= 10
    assert service["KillMode"] == ["mixed"]
    assert service["RestartPreventExitStatus"] == ["2 78"]


def test_what_real_time_needs_is_granted_and_the_compiled_steps_have_a_place(service):
    assert service["LimitRTPRIO"] == ["99"]
    assert service["LimitMEMLOCK"] == ["infinity"]
    assert "RestrictRealtime" not in service
    assert "MemoryDenyWriteExecute" not in service
    assert f"NUMBA_CACHE_DIR=/var/cache/{service['CacheDirectory'][0]}" in service["Environment"]


def test_the_account_is_made_by_sysusers(service):
    lines = (UNIT.parent / "piezod.sysusers.conf").read_text(encoding="utf-8").splitlines()
    assert [line.split()[:2] for line in lines if line.startswith("u ")] == [["u", service["User"][0]]]


@pytest.fixture(scope="module")
def daily():
    """Lines of the unit of the daily check."""
    return (UNIT.parent / "piezod-check@.service").read_text(encoding="utf-8").splitlines()


@analyze
@pytest.mark.parametrize("name", ["piezod-check@.service", "piezod-check@.timer"])
def test_systemd_finds_nothing_to_say_of_the_daily_check(name):
    done = told("verify", UNIT.parent / name)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == ""


def test_the_daily_check_runs_behind_everything_else_and_never_drives(daily):
    assert {"Nice=19", "CPUSchedulingPolicy=idle", "IOSchedulingClass=idle", "PrivateDevices=yes"} <= set(daily)
    assert {"PrivateNetwork=yes", "RestrictRealtime=yes", "SuccessExitStatus=75"} <= set(daily)
    (command,) = [line for line in daily if line.startswith("ExecStart=")]
    assert command.split()[1:4] == ["piezod", "diagnose", "--from-archive"]
