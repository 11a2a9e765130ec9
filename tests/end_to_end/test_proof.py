"""`piezod check --proof` as a command; `tests/simulation/test_proof.py` judges its steps."""

import json
import struct
import time

import pytest
from pymodbus.client import ModbusTcpClient

from piezod.commissioning.proof import prove
from piezod.commissioning.safe_stop import stop_directly
from piezod.config import load_bench
from piezod.daemon.proof_date import proven_sections
from piezod.errors import BusyError, UsageError
from piezod.session.heat_file import HeatFile
from piezod.session.lock import BenchLock
from tests.faults.bench_pool import run_piezod
from tests.faults.live_bench import LiveBench
from tests.faults.probe import Probe, repeated_after_standstills


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


@pytest.mark.slow
def test_the_command_ends_with_0_where_every_step_passes(bench, tmp_path, probe):
    def attempt(number):
        path = tmp_path / f"record_{number}.json"
        code, text, _ = run_piezod("check", bench.path, "--proof", "-o", path)
        assert code == 0, text
        return json.loads(path.read_text(encoding="utf-8"))

    record = repeated_after_standstills(probe, attempt)
    assert record["passed"]
    assert record["proven"] == proven_sections(load_bench(bench.path))
    assert bench.device.ask("report")["wrong"] == []


def test_the_command_ends_with_1_where_a_step_fails(bench, tmp_path):
    bench.device.ask("reading_fault", kind="stuck")
    assert run_piezod("check", bench.path, "--proof", "-o", tmp_path / "record.json")[0] == 1


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


@pytest.mark.slow
def test_a_proof_test_takes_and_keeps_the_account_of_the_heat(bench, tmp_path, probe):
    def attempt(number):
        HeatFile(load_bench(bench.path)).keep(1.5)
        record, _ = prove(bench.path, tmp_path / f"record_{number}.json")
        assert steps_of(record)["heat"]["result"] == "pass"

    repeated_after_standstills(probe, attempt)
    assert 0.0 < HeatFile(load_bench(bench.path)).pop() < 1.5
