"""Whole sessions on the emulated bench: stopped, interrupted, fed by a PLC or a stream, over every wire."""

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from html.parser import HTMLParser

import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient

from piezod.control import RingReader
from piezod.recording import read_csv
from tests.benches.daemon import WITHIN_S, until
from tests.benches.emulator import bench_file, emulator, piezod
from tests.benches.processes import Popen

PATIENT = {"comm_loss_ms": 2000, "device_watchdog_ms": 1000, "missed_ticks_in_a_row": 100}


@contextlib.contextmanager
def running(bench, *arguments):
    """`piezod run` as a child; ended by its id whatever happens."""
    process = Popen([sys.executable, "-m", "piezod", "run", str(bench), *arguments], stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        process.stderr.close()


def wait_for(process, word):
    """Lines up to the one with `word`."""
    lines = []
    for line in process.stderr:
        lines.append(line)
        if word in line:
            return lines
    raise AssertionError(f"'{word}' was never said: {lines}")


def fetched_by(page):
    """What a browser would have to fetch to show the page."""
    addresses = []

    class Tags(HTMLParser):
        def handle_starttag(self, tag, attrs):
            if tag in {"script", "link", "img", "iframe"}:
                addresses.extend(value for key, value in attrs if key in {"src", "href"})

    Tags().feed(page)
    return addresses


def register(serves, address, count=2):
    host, _, port = serves["tcp"].rpartition(":")
    with ModbusTcpClient(host, port=int(port), timeout=2) as client:
        words = client.read_holding_registers(address, count=count, device_id=1).registers
    return struct.unpack(">f", struct.pack(">2H", *words))[0]


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_ramps_down_and_the_voltage_is_back_at_zero(number, tmp_path):
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT)
        with running(bench, "--arm") as process:
            wait_for(process, "RUNNING")
            until(lambda: register(serves, 202) > 5.0)
            os.kill(process.pid, number)
            said = "".join(wait_for(process, "tracking"))
            assert process.wait(timeout=WITHIN_S) == 0
        assert "RAMP_DOWN: stop requested" in said
        assert "DISARMED: safe voltage reached" in said
        assert register(serves, 202) == pytest.approx(0.0, abs=0.1)


def test_the_control_process_ramps_down_when_the_one_that_started_it_is_killed(tmp_path):
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT)
        with running(bench, "--arm") as process:
            wait_for(process, "RUNNING")
            until(lambda: register(serves, 202) > 5.0)
            process.kill()
            process.wait()
            until(lambda: register(serves, 100) == 0.0)
            until(lambda: abs(register(serves, 202)) <= 0.1)
        assert register(serves, 100) == 0.0


def test_without_arm_nothing_is_written(tmp_path):
    with emulator("--port", "0") as serves:
        with running(bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT)) as process:
            wait_for(process, "reading only")
            time.sleep(1.0)
            process.terminate()
            wait_for(process, "failed exchanges")
            assert process.wait(timeout=WITHIN_S) == 0
        host, _, port = serves["tcp"].rpartition(":")
        with ModbusTcpClient(host, port=int(port)) as client:
            assert client.read_holding_registers(100, count=3, device_id=1).registers == [0, 0, 0]
            assert client.read_holding_registers(110, count=1, device_id=1).registers == [0]


def test_a_plc_writes_the_reference_and_its_silence_ramps_down(tmp_path):
    reference = {"kind": "register", "stale_after_s": 0.5, "when_stale": "ramp_down"}
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT, reference=reference)
        host, _, port = serves["tcp"].rpartition(":")
        with running(bench, "--arm") as process, ModbusTcpClient(host, port=int(port)) as plc:
            values = np.concatenate((np.full(60, 80.0), np.linspace(80.0, 120.0, 40)))
            for counter, value in enumerate(values):
                plc.write_registers(209, [*struct.unpack(">2H", struct.pack(">f", value)), counter + 1], device_id=1)
                time.sleep(0.05)
            said = "".join(wait_for(process, "tracking"))
            assert process.wait(timeout=WITHIN_S) == 0
    assert "RUNNING: first reference reached" in said
    assert "RAMP_DOWN: reference stale" in said


def test_a_stream_of_datagrams_is_followed_until_it_stops(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        address = probe.getsockname()
    listen = f"udp://{address[0]}:{address[1]}"
    reference = {"kind": "stream", "listen": listen, "stale_after_s": 0.5, "when_stale": "ramp_down"}
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT, reference=reference)
        with running(bench, "--arm") as process, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for sequence in range(800):
                force_N = 100.0 + 40.0 * np.sin(2 * np.pi * 0.5 * sequence * 0.01)
                with contextlib.suppress(ConnectionRefusedError):
                    sender.sendto(struct.pack("<QQd", sequence, time.time_ns(), force_N), address)
                time.sleep(0.01)
            said = "".join(wait_for(process, "tracking"))
            assert process.wait(timeout=WITHIN_S) == 0
    assert "RAMP_DOWN: reference stale" in said
    rms_N = float(said.rpartition("rms error ")[2].split()[0])
    assert rms_N < 2.0


def test_the_same_excitation_gives_the_same_recording_over_every_wire(tmp_path):
    recordings = {}
    for wire, option in (
        ("tcp", ("--port", "0")),
        ("rtu", ("--rtu", "--port", "0")),
        ("line", ("--line", "--port", "0")),
    ):
        folder = tmp_path / wire
        folder.mkdir()
        with emulator("--time", "virtual", *option) as serves:
            bench = bench_file(folder, {wire: serves[wire]}, rate_Hz=200, limits={"stale_after_ms": 20})
            output = folder / "rec.csv"
            done = piezod("record", bench, "--excitation", "varying-triangles", "--frequency", "1", "-o", output)
            assert done.returncode == 0, done.stderr
        recordings[wire] = read_csv(output)
    tcp, rtu, line = (recordings[wire] for wire in ("tcp", "rtu", "line"))
    assert tcp.time_s.size == 1000
    np.testing.assert_array_equal(rtu.channel("voltage_V"), tcp.channel("voltage_V"))
    np.testing.assert_array_equal(rtu.channel("force_N"), tcp.channel("force_N"))
    assert line.channel("voltage_V").max() == pytest.approx(140.0)


def test_a_ring_log_is_there_while_the_bench_runs_and_gone_afterwards(tmp_path):
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=200, limits=PATIENT)
        with running(bench, "--arm") as process:
            wait_for(process, "ARMING")
            reader = RingReader(tmp_path / "ring")
            until(lambda: reader.waiting > 50)
            process.terminate()
            wait_for(process, "failed exchanges")
            process.wait(timeout=WITHIN_S)
    assert not (tmp_path / "ring").exists()


@pytest.mark.slow
def test_the_demo_shows_that_at_most_a_quarter_of_the_hysteresis_is_left(tmp_path):
    page, figures = tmp_path / "demo.html", tmp_path / "demo.json"
    done = piezod("demo", "--report", page, "--json", figures, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(figures.read_text(encoding="utf-8"))
    assert result["passed"]
    assert result["failed_exchanges"] == 0
    hidden = result["hidden"]
    assert hidden["diagnosis"].startswith("explained: ")
    assert all(words in hidden["diagnosis"] for words in ("creep of the stack", "time constant", "delay"))
    rms = {row["compensation"]: row["rms_error_N"] for row in hidden["figures"]}
    assert hidden["noise_N"] < rms["extended"] < 0.25 * rms["inverse"] < 0.25 * rms["gain"]
    assert "virtual time" in done.stdout
    opening = {
        row["compensation"]: row["max_hysteresis_percent"]
        for row in result["figures"]
        if row["reference"] == "triangle"
    }
    assert opening["inverse"] <= opening["gain"] / 4
    text = page.read_text(encoding="utf-8")
    assert "Demo: the force follows a reference" in text
    assert "extended inverse" in text
    assert not fetched_by(text)
    assert len(text) < 3_000_000


@pytest.mark.slow
def test_the_quick_demo_follows_one_reference_and_diagnoses_nothing(tmp_path):
    figures = tmp_path / "demo.json"
    done = piezod("demo", "--quick", "--report", tmp_path / "demo.html", "--json", figures, timeout=120)
    result = json.loads(figures.read_text(encoding="utf-8"))
    assert [(row["reference"], row["compensation"]) for row in result["figures"]] == [
        ("triangle", "gain"),
        ("triangle", "inverse"),
    ], done.stdout + done.stderr
    assert result.get("hidden") is None


def test_an_interrupted_demo_ramps_down_says_so_and_does_not_pass(tmp_path):
    process = Popen(
        [sys.executable, "-m", "piezod", "demo", "--report", str(tmp_path / "demo.html")],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        for line in process.stdout:
            if "RUNNING" in line:
                os.killpg(process.pid, signal.SIGINT)
                break
        rest = process.stdout.read()
        assert process.wait(timeout=20) == 1
    assert "stopped: ramped down before the end" in rest
