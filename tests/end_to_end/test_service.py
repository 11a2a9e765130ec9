"""The daemon as a service: commanded, refused, reloaded, killed and found again."""

import contextlib
import json
import os
import signal
import struct
import time
import urllib.request

import pytest
import yaml

from piezod.config import load_bench
from piezod.errors import TemporaryError
from tests.benches.daemon import PATIENT, WITHIN_S, change, client, daemon, register
from tests.benches.emulator import bench_file, emulator, piezod

READBACK, SET_POINT = 202, 100


@pytest.fixture
def serves():
    with emulator("--port", "0") as served:
        yield served


@pytest.fixture
def bench(serves, tmp_path):
    return bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT, arming={"voltage_V_per_s": 800.0})


def one_line(done, code, says):
    assert done.returncode == code, done.stdout + done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert says in done.stderr


def test_a_bench_is_armed_and_disarmed_over_the_socket_and_the_service_stays(bench, serves):
    with daemon(bench) as service:
        service.connected()
        time.sleep(0.5)
        assert service.status()["state"] == "DISARMED"
        assert register(serves, SET_POINT) == 0.0
        armed = service.command("arm", "--json")
        assert armed.returncode == 0, armed.stderr
        assert json.loads(armed.stdout)["state"] == "RUNNING"
        service.wait_until(lambda: register(serves, READBACK) > 3.0, "a voltage")
        disarmed = service.command("disarm", "--json")
        assert json.loads(disarmed.stdout)["state"] == "DISARMED"
        assert register(serves, READBACK) == pytest.approx(0.0, abs=0.1)
        assert service.tell("arm")["state"] == "RUNNING"
        assert service.tell("stop")["state"] == "DISARMED"
        assert register(serves, READBACK) == pytest.approx(0.0, abs=0.1)
        assert service.end() == 0
    assert "socket: arm by uid " in "".join(service.said)


@pytest.mark.slow
def test_signals_that_arrive_until_the_very_end_leave_no_traceback_and_the_service_ends_well(bench):
    with daemon(bench) as service:
        service.connected()
        service.signal(signal.SIGTERM)
        end_s = time.monotonic() + 20.0
        while service.process.poll() is None and time.monotonic() < end_s:
            with contextlib.suppress(ProcessLookupError):
                service.process.send_signal(signal.SIGHUP)
                service.process.send_signal(signal.SIGTERM)
            time.sleep(0.02)
        assert service.process.poll() == 0
    assert "Traceback" not in "".join(service.said)


def test_the_status_tells_state_values_and_counts(bench):
    with daemon(bench) as service:
        service.connected()
        service.wait_until(lambda: service.status()["ticks"] > 5, "the first ticks")
        status = service.status()
        assert (status["schema"], status["bench"], status["state"]) == ("piezod.status/1", "emulator", "DISARMED")
        assert abs(status["force_N"]) < 5.0
        assert abs(status["readback_V"]) < 0.1
        assert status["failed_exchanges"] == 0
        assert status["rate_Hz"] == 200
        text = service.command("status").stdout
        assert text.startswith("emulator: DISARMED")
    one_line(piezod("status", bench), 75, "is the daemon running?")


def test_what_the_state_does_not_allow_is_refused(bench):
    with daemon(bench) as service:
        service.connected()
        service.refuses("reset", "must be FAULT")
        assert service.tell("arm")["state"] == "RUNNING"
        one_line(service.command("arm"), 1, "state is RUNNING, must be DISARMED")
        one_line(piezod("status", bench, "--socket", "/x"), 2, "CONFIG and --socket are both given")


def test_a_second_instance_and_a_recording_beside_it_are_refused(bench, tmp_path):
    with daemon(bench) as service:
        service.connected()
        one_line(piezod("run", bench), 75, f"process {service.process.pid} drives or watches this bench")
        done = piezod("record", bench, "--excitation", "constant-triangles", "-o", tmp_path / "x.csv")
        one_line(done, 75, "drives or watches this bench")


def test_a_direct_stop_lets_the_service_stop_and_never_takes_a_living_one_for_dead(bench, serves):
    with daemon(bench) as service:
        service.connected()
        assert service.tell("arm")["state"] == "RUNNING"
        load_bench(bench).lock_path.write_text("")
        done = piezod("stop", bench, "--direct")
        assert done.returncode == 0, done.stderr
        assert "stopped by the program that drives; at rest, DISARMED" in done.stdout
        assert register(serves, READBACK) == pytest.approx(0.0, abs=0.1)
        time.sleep(2.0)
        assert service.tell("arm")["state"] == "RUNNING"
        service.signal(signal.SIGSTOP)
        one_line(piezod("stop", bench, "--direct"), 75, "kill -9 makes its control process ramp down")
        service.process.kill()
        service.process.wait()
        done = piezod("stop", bench, "--direct")
        assert done.returncode == 0, done.stderr
        assert register(serves, READBACK) == pytest.approx(0.0, abs=0.1)


def test_a_fault_is_latched_until_it_is_reset_and_nothing_arms_by_itself(bench, serves):
    with daemon(bench) as service:
        service.connected()
        assert service.tell("arm")["state"] == "RUNNING"
        change(bench, "force_trip_N: 360.0", "force_trip_N: 30.0")
        service.tell("reload")
        service.wait_for("FAULT: force above limits.force_trip_N")
        assert register(serves, READBACK) == pytest.approx(0.0, abs=0.1)
        service.refuses("arm", "state is FAULT (force above limits.force_trip_N")
        assert service.status()["fault"].startswith("force above")
        service.tell("reset")
        time.sleep(1.0)
        assert service.status()["state"] == "DISARMED"
        assert register(serves, SET_POINT) == 0.0
        assert service.end() == 0


def test_a_reversed_sensor_is_noticed_by_the_first_small_step(serves, tmp_path):
    path = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT)
    change(path, "      function: 23\n      high: 1000\n", "      function: 23\n      scale: -1.0\n      high: 1000\n")
    with daemon(path) as service:
        service.connected()
        with client(serves) as modbus:
            done = service.command("arm", "--json")
            assert done.returncode == 1
            status = json.loads(done.stdout)
            assert status["state"] == "FAULT"
            assert "did not rise by arming.sign_check.rise_N" in status["fault"]
            assert modbus.read_holding_registers(SET_POINT, count=2, device_id=1).registers == [0, 0]
        assert service.end() == 1


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("device_watchdog_ms: 1000", "device_watchdog_ms: 0", "limits.device_watchdog_ms is 0, must be above 0"),
        ("expect: 20570", "expect: 20571", "20570, expected 20571"),
        ("expect: 1\n", "expect: 2\n", "is 1, expected 2"),
        ("readback_within_V: 2", "readback_within_V: 1.0e-09", "the amplifier reads back"),
        ("agree_within_N: null", "agree_within_N: 1.0e-09", "two force readings are"),
        ("force_min_N: -20.0", "force_min_N: 50.0", "N at rest, must be within limits.force_min_N, 50"),
    ],
)
def test_arming_is_refused_when_a_precondition_does_not_hold(serves, tmp_path, old, new, says):
    path = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT)
    change(path, old, new)
    done = piezod("run", path, "--arm")
    assert done.returncode in (1, 78), done.stderr
    assert says in done.stderr.strip().splitlines()[-1]
    with client(serves) as modbus:
        assert modbus.read_holding_registers(SET_POINT, count=3, device_id=1).registers == [0, 0, 0]


@pytest.mark.parametrize("role", ["identity", "map_version", "voltage_readback"])
def test_arming_needs_what_the_map_does_not_name_unless_it_is_listed(serves, tmp_path, role):
    path = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT | {"readback_trip_V": None})
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    del content["link"]["registers"][role]
    content["reference"]["duration_s"] = 0.1
    content["arming"]["reset_cycle"] = False
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    one_line(piezod("run", path, "--arm"), 1, f"the link names no {role}")
    content["arming"]["without"] = [role]
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    done = piezod("run", path, "--arm")
    assert done.returncode == 0, done.stderr


def test_while_armed_only_tighter_limits_are_taken(bench):
    with daemon(bench) as service:
        service.connected()
        assert service.tell("arm")["state"] == "RUNNING"
        before = bench.read_text(encoding="utf-8")
        change(bench, "force_trip_N: 360.0", "force_trip_N: 361.0")
        service.refuses("reload", "limits.force_trip_N would go from 360 to 361, which is looser")
        service.signal(signal.SIGHUP)
        service.wait_for("reload refused, the old configuration stays: reload: while RUNNING limits.force_trip_N")
        bench.write_text("rate_Hz: [", encoding="utf-8")
        service.signal(signal.SIGHUP)
        service.wait_for("not valid YAML")
        bench.write_text(before, encoding="utf-8")
        change(bench, "amplitude_N: 110", "amplitude_N: 100")
        service.refuses("reload", "only limits may change; disarm first")
        bench.write_text(before, encoding="utf-8")
        change(bench, "force_trip_N: 360.0", "force_trip_N: 350.0")
        service.signal(signal.SIGHUP)
        service.wait_for("reload: limits taken")
        assert service.status()["state"] == "RUNNING"


def test_when_disarmed_a_whole_configuration_is_taken_but_no_name(bench):
    with daemon(bench) as service:
        service.connected()
        change(bench, "rate_Hz: 200", "rate_Hz: 250")
        service.signal(signal.SIGHUP)
        service.wait_for("configuration taken")
        service.wait_for("emulator: 250 Hz, reading only")
        assert service.status()["rate_Hz"] == 250
        assert [line for _, line in service.told if line == "RELOADING=1"]
        change(bench, "name: emulator", "name: other")
        service.refuses("reload", "can only change with a restart")
        assert service.tell("arm")["state"] == "RUNNING"


@pytest.mark.slow
def test_a_device_that_does_not_answer_is_waited_for_and_found(tmp_path):
    with emulator("--port", "0") as served:
        port = served["tcp"].rpartition(":")[2]
    path = bench_file(tmp_path, served, rate_Hz=200, limits=PATIENT)
    with daemon(path) as service:
        service.ready()
        service.wait_until(lambda: service.has_told("STATUS=DISARMED, link: "), "the status")
        service.refuses("arm", "the device is not connected", TemporaryError)
        assert "refused" in service.status()["problem"]
        with emulator("--port", port):
            service.connected()
            service.wait_until(lambda: service.status()["connected"], "the first good exchange")
            assert service.status()["state"] == "DISARMED"
            assert service.end() == 0


def test_a_stop_while_nobody_answers_ends_at_once(tmp_path):
    path = bench_file(tmp_path, {"tcp": "127.0.0.1:3"}, rate_Hz=200, limits=PATIENT)
    with daemon(path) as service:
        service.ready()
        assert service.end() == 0


def test_systemd_hears_of_the_ticks_and_of_nothing_when_they_stop(bench):
    with daemon(bench) as service:
        service.connected()
        service.ready()
        service.wait_until(lambda: service.status()["ticks"] > 10, "some ticks")
        service.wait_until(lambda: sum(line == "WATCHDOG=1" for _, line in service.told) > 10, "ten signs of life")
        child = service.control_pid()
        os.kill(child, signal.SIGSTOP)
        time.sleep(0.5)
        heard = len([line for _, line in service.told if line == "WATCHDOG=1"])
        time.sleep(1.0)
        assert len([line for _, line in service.told if line == "WATCHDOG=1"]) == heard
        os.kill(child, signal.SIGCONT)
        service.wait_until(
            lambda: len([line for _, line in service.told if line == "WATCHDOG=1"]) > heard, "another sign of life"
        )
        assert service.end() == 0
    assert service.has_told("STOPPING=1")


@pytest.mark.slow
def test_a_killed_control_process_ends_the_service_and_the_device_is_safe_by_itself(bench, serves):
    with daemon(bench) as service:
        service.connected()
        assert service.tell("arm")["state"] == "RUNNING"
        service.wait_until(lambda: register(serves, READBACK) > 3.0, "a voltage")
        os.kill(service.control_pid(), signal.SIGKILL)
        assert service.process.wait(timeout=WITHIN_S) == 1
        assert "the control process ended with code -9" in "".join(service.said)
    time.sleep(2.0)
    assert register(serves, READBACK) == pytest.approx(0.0, abs=0.1)
    done = piezod("stop", bench, "--direct")
    assert done.returncode == 0, done.stderr
    assert "at rest" in done.stdout


def test_a_voltage_that_nobody_drives_is_brought_down_directly(bench, serves):
    with client(serves) as modbus:
        modbus.write_registers(SET_POINT, [*struct.unpack(">2H", struct.pack(">f", 80.0)), 1], device_id=1)
    time.sleep(0.1)
    assert register(serves, READBACK) == pytest.approx(80.0, abs=0.1)
    done = piezod("stop", bench, "--direct", "--json")
    assert done.returncode == 0, done.stderr
    assert "ramped down from 80.00 V" in json.loads(done.stdout)["message"]
    assert register(serves, READBACK) == pytest.approx(0.0, abs=0.1)


def test_another_device_is_not_brought_down_directly(bench, serves):
    with client(serves) as modbus:
        modbus.write_registers(SET_POINT, [*struct.unpack(">2H", struct.pack(">f", 80.0)), 1], device_id=1)
    change(bench, "expect: 20570", "expect: 20571")
    one_line(piezod("stop", bench, "--direct"), 78, "20570")
    assert register(serves, SET_POINT) == 80.0


def test_metrics_are_scraped_from_the_loopback(serves, tmp_path):
    path = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT)
    change(path, "daemon:\n", "daemon:\n  metrics_port: 0\n")
    with daemon(path) as service:
        service.connected()
        address = next(line.split()[1] for line in service.said if line.startswith("metrics: "))
        assert address.startswith("http://127.0.0.1:")
        service.wait_until(lambda: service.status()["ticks"] > 10, "some ticks")
        with urllib.request.urlopen(address, timeout=5) as page:
            text = page.read().decode()
    assert 'piezod_state{bench="emulator",state="disarmed"} 1.0' in text
    assert float(next(line for line in text.splitlines() if line.startswith("piezod_ticks_total")).split()[1]) > 10
