"""`piezod check --proof` on an emulated bench in real time."""

import functools
import json
import os
import signal
import struct
import sys
import threading
import time

import pytest
from pymodbus.client import ModbusTcpClient

from piezod.commissioning.proof import STEPS, prove, sequence
from piezod.commissioning.proof.sequence import ProofTest
from piezod.commissioning.safe_stop import stop_directly
from piezod.config import load_bench
from piezod.errors import BusyError, UsageError
from piezod.session.heat_file import HeatFile
from piezod.session.lock import BenchLock
from tests.benches.processes import Popen
from tests.faults.bench_pool import run_piezod
from tests.faults.live_bench import LiveBench
from tests.faults.probe import Probe, repeated_after_standstills

pytestmark = pytest.mark.real_time

AT_ONCE = ("minimum", "temperature", "thermometer", "clamp")  # steps that end in their first ticks, or are skipped


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    live = LiveBench(tmp_path_factory.mktemp("proof"))
    yield live
    live.close()


@pytest.fixture(scope="module")
def probe():
    sleeper = Probe()
    yield sleeper
    sleeper.close()


@pytest.fixture(autouse=True)
def restored(bench):
    yield
    assert abs(bench.device.ask("report")["output_V"]) <= 0.5, "the bench is not at rest"
    bench.device.ask("reading_fault")
    bench.device.ask("other_device")


def steps_of(record):
    return {step["name"]: step for step in record["steps"]}


def test_every_step_passes_and_the_record_names_bench_device_version_and_date(bench, tmp_path, probe):
    def attempt(number):
        path = tmp_path / f"record_{number}.json"
        code, text, _ = run_piezod("check", bench.path, "--proof", "-o", path)
        assert code == 0, text
        return json.loads(path.read_text(encoding="utf-8"))

    record = repeated_after_standstills(probe, attempt)
    assert record["passed"] is record["left_at_rest"] is True
    assert [step["name"] for step in record["steps"]] == list(STEPS)
    assert {step["name"] for step in record["steps"] if step["result"] != "pass"} == {"clamp"}  # null in the bench file
    assert record["coverage"]["proven"] == record["coverage"]["configured"] - 3
    assert all(not reason.startswith("step ") for reason in record["coverage"]["not_proven"].values())
    assert record["identity"] == {"identity": 20570.0, "map_version": 1.0}
    assert {"schema", "bench", "device", "version", "date_utc"} <= set(record)
    done = [step for step in record["steps"] if step["result"] == "pass"]
    assert all(step["measured"] is not None and step["limit"] is not None for step in done)
    report = bench.device.ask("report")
    assert report["highest_V"] <= 7.5
    assert report["wrong"] == []


def test_a_watchdog_that_is_set_and_does_not_act_fails_and_the_bench_is_left_at_rest(bench, tmp_path, probe):
    bench.device.ask("other_device", acts_on_watchdog=False)

    def attempt(number):
        record, _ = prove(bench.path, tmp_path / f"record_{number}.json")
        steps = steps_of(record)
        assert steps.pop("watchdog")["result"] == "fail"
        assert {step["result"] for name, step in steps.items() if name != "clamp"} == {"pass"}
        assert record["coverage"]["not_proven"]["device_watchdog_ms"] == "step watchdog: fail"
        return record

    record = repeated_after_standstills(probe, attempt)
    assert record["left_at_rest"]
    assert not record["passed"]


def test_a_stuck_load_cell_fails_the_first_step_and_ends_the_test(bench, tmp_path):
    bench.device.ask("reading_fault", kind="stuck")
    record, _ = prove(bench.path, tmp_path / "record.json")
    assert [step["result"] for step in record["steps"]] == ["fail"]
    assert not record["passed"]
    assert run_piezod("check", bench.path, "--proof", "-o", tmp_path / "second.json")[0] == 1


def test_a_readback_that_stands_still_fails(bench, tmp_path):
    bench.device.ask("reading_fault", kind="readback_stuck")
    record, _ = prove(bench.path, tmp_path / "record.json")
    assert steps_of(record)["level"]["result"] == "fail"


def test_a_voltage_behind_a_readback_that_stands_still_is_brought_down(bench):
    bench.device.ask("other_device", acts_on_watchdog=False)
    bench.device.ask("reading_fault", kind="readback_stuck")
    host, _, port = bench.device.serves["direct"].rpartition(":")
    with ModbusTcpClient(host, port=int(port)) as client:
        client.read_input_registers(202, count=2)  # from now on the readback says 0 V
        client.write_registers(100, [*struct.unpack(">2H", struct.pack(">f", 6.0)), 1])
    time.sleep(0.1)
    assert bench.device.ask("report")["output_V"] == 6.0
    assert "ramped down from 6.00 V" in stop_directly(bench.path)
    assert bench.device.ask("report")["output_V"] == 0.0


def test_a_bench_that_another_program_drives_is_refused(bench, tmp_path):
    lock = BenchLock(load_bench(bench.path).lock_path)
    try:
        with pytest.raises(BusyError):
            prove(bench.path, tmp_path / "record.json")
    finally:
        lock.close()
    assert not (tmp_path / "record.json").exists()


def test_a_record_is_never_replaced(bench, tmp_path):
    path = tmp_path / "record.json"
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(UsageError, match="already exists"):
        prove(bench.path, path)
    assert path.read_text(encoding="utf-8") == "{}"


class InterruptedTest(ProofTest):
    """A proof test of two steps, whose parent gets Ctrl-C in the second one."""

    def __init__(self, name, *arguments):
        super().__init__(*arguments)
        self._name = name

    def run(self, loop):
        """Run the steps `level` and the one that is interrupted."""
        name, all_steps = self._name, dict(STEPS)

        def interrupted(proof):
            if name in AT_ONCE:
                os.kill(os.getppid(), signal.SIGINT)
                time.sleep(0.2)
            else:
                threading.Timer(0.05, lambda: os.kill(os.getppid(), signal.SIGINT)).start()
            return all_steps[name](proof)

        STEPS.clear()
        STEPS.update({"level": all_steps["level"]} | {name: interrupted})
        return super().run(loop)


@pytest.mark.parametrize("name", STEPS)
def test_ctrl_c_leaves_the_bench_at_rest_and_writes_a_record_that_did_not_pass(
    bench, tmp_path, monkeypatch, name, probe
):
    def attempt(number):
        record, path = prove(bench.path, tmp_path / f"record_{number}.json")
        assert record["steps"][-1]["name"] == name
        return record, path

    monkeypatch.setattr(sequence, "ProofTest", functools.partial(InterruptedTest, name))
    record, path = repeated_after_standstills(probe, attempt)
    assert not record["passed"]
    assert record["left_at_rest"]
    assert record["remark"] == "interrupted"
    assert json.loads(path.read_text(encoding="utf-8")) == record


@pytest.mark.parametrize("command", ["stop", "disarm"])
def test_another_operator_sees_and_ends_a_proof_test(bench, tmp_path, command):
    path = tmp_path / "record.json"
    process = Popen([sys.executable, "-m", "piezod", "check", str(bench.path), "--proof", "-o", str(path)])
    try:
        while bench.device.ask("report")["output_V"] < 5.0:
            assert process.poll() is None
            time.sleep(0.02)
        code, text, _ = run_piezod("status", bench.path, "--json")
        assert (code, json.loads(text)["connected"]) == (0, True)
        assert run_piezod(command, bench.path)[0] in (0, 1)  # 1: at rest in FAULT, which a step has just provoked
        assert process.wait(10.0) == 1
    finally:
        process.kill()
        process.wait()
    record = json.loads(path.read_text(encoding="utf-8"))
    assert (record["remark"], record["left_at_rest"], record["passed"]) == ("interrupted", True, False)
    assert len(record["steps"]) < len(STEPS)


def test_a_proof_test_takes_and_keeps_the_account_of_the_heat(bench, tmp_path, probe):
    def attempt(number):
        HeatFile(load_bench(bench.path)).keep(1.5)
        record, _ = prove(bench.path, tmp_path / f"record_{number}.json")
        assert steps_of(record)["heat"]["result"] == "pass"

    repeated_after_standstills(probe, attempt)
    assert 0.0 < HeatFile(load_bench(bench.path)).pop() < 1.5
