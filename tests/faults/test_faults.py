"""Every listed fault is injected and has its expected result."""

import inspect
import os
import signal
import time

import pytest

from piezod.errors import ConfigurationError
from tests.faults import disk_faults, run
from tests.faults.bench_pool import open_bench_pool
from tests.faults.catalogue import load_faults
from tests.faults.live_bench import DeviceProcess
from tests.faults.probe import STILL_MS, Probe
from tests.simulation.rows import OF_PROCESSES, rows

FAULTS = run.faults()
KEPT_LIVE = {
    "T1": "READY at systemd, and the exit code of the command",
    "T2": "a real queue that is full",
    "T3": "a real TCP reset and refused connections",
    "T11": "real segments",
    "T14": "a real connection that is closed at once",
    "T19": "the lock of a real port",
    "P1": "a forged reply on a real socket",
    "P10": "bytes of a real terminal",
    "P14": "exit code and message of the command",
    "P18": "a second Modbus client",
    "S11": "a second Modbus client that writes the voltage",
    "M4": "SIGSTOP of a real process",
    "M10": "real buffers of a socket whose client never reads",
    "V6": "one false reading through real processes",
    "V14": "a restart of the device process",
    "V17": "datagrams of a real socket",
    "V19": "exit code and message of the command for a reference file",
    "C8": "exit code and message of the command for a model",
    "C9": "SIGHUP of a real process",
    "R1": "SIGTERM of real processes",
    "R4": "SIGKILL of real processes",
    "R7": "notifications to a real socket of systemd",
    "R9": "a lock between real processes",
    "R10": "files that another program has left",
    "R21": "a real pipe that is full",
    "R26": "the time to look at a real file of 3 GB",
    "R29": "queues of real sockets",
    "S14": "a thousand real connections",
    "R18": "the parent-death signal of the kernel",
}
"""Faults that also run in `tests/simulation`, and what only their injection into real processes shows. The other
simulated ones are slow here, unless the list bounds a figure that only a real process has."""
NOT_JUDGED = []


@pytest.fixture(scope="module")
def pool():
    with open_bench_pool() as benches:
        yield benches


@pytest.fixture(scope="module")
def probe():
    sleeper = Probe()
    yield sleeper
    sleeper.close()


def _is_shown_by_the_simulation(fault):
    return fault.id in SIMULATED and fault.id not in KEPT_LIVE and not {*fault.expect.figures} & {*OF_PROCESSES}


SIMULATED = rows()
LIVE = [fault for fault in FAULTS if not _is_shown_by_the_simulation(fault)]


def listed(fault):
    """A fault as a parameter.

    Faults of the disk repeat the tests and the study of the recorder, and a cold cache compiles for a minute: they are
    slow. Benches without a process of their own do not depend on the real clock. What the simulation shows as well is
    slow too.
    """
    if _is_shown_by_the_simulation(fault):
        return pytest.param(fault, id=fault.id, marks=pytest.mark.slow)
    if fault.injector in {*disk_faults.INJECTORS, "armed_on_a_cold_cache"}:
        return pytest.param(fault, id=fault.id, marks=pytest.mark.slow)
    return pytest.param(fault, id=fault.id, marks=() if fault.injector in run.IN_PROCESS else pytest.mark.real_time)


@pytest.mark.parametrize("fault", [listed(fault) for fault in FAULTS])
def test_fault_has_its_expected_result(fault, pool, probe):
    result = run.run(fault, pool, probe)
    if result.skipped.startswith(run.NOT_JUDGED):
        NOT_JUDGED.append(fault.id)
    if result.skipped:
        pytest.skip(f"{fault.id}: {result.skipped}")
    assert not result.problems, f"{result.text()}\nobserved: {result.observed and result.observed.figures}"


@pytest.mark.real_time
def test_nearly_every_fault_is_judged():
    """A service that fails without faults too would otherwise pass as a slow machine."""
    assert len(NOT_JUDGED) <= 0.1 * len(LIVE), f"not judged: {' '.join(NOT_JUDGED)}"


@pytest.mark.parametrize("name", sorted(run.INJECTORS))
def test_a_fault_that_asks_for_a_running_bench_is_judged_in_real_time(name):
    assert not (name in run.IN_PROCESS and "pool.bench(" in inspect.getsource(run.INJECTORS[name]))


def test_every_fault_that_is_kept_live_runs_in_the_simulation():
    assert {*KEPT_LIVE} <= {*SIMULATED}


def test_at_least_a_hundred_faults_are_injected_without_other_tests():
    assert sum(fault.injector != "checked" for fault in FAULTS) >= 100


@pytest.mark.real_time
def test_device_process_reports_its_own_standstill():
    device = DeviceProcess({})
    try:
        device.ask("mark")
        os.kill(device.process.pid, signal.SIGSTOP)
        time.sleep(0.05)
        os.kill(device.process.pid, signal.SIGCONT)
        time.sleep(0.05)
        assert device.ask("report")["behind_ms"] > 50.0 - 2 * STILL_MS
        device.ask("mark")
        assert device.ask("report")["behind_ms"] < 50.0 - 2 * STILL_MS
    finally:
        device.close()


ROW = """\
schema: piezod.faults/1
faults:
  - id: T1
    fault: something breaks
    inject: {by: running, steps: []}
    expect: {state: FAULT}
    within: 10 ms
"""


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("within: 10 ms", "within: 10 ms\n    color: red", "unknown key faults.0.color"),
        ("within: 10 ms", "within: 10 minutes", "within"),
        ("expect: {state: FAULT}", "expect: {}", "needs a state, an exit_code, says or figures"),
        ("state: FAULT", "figures: {failed: {}}", "needs least, most, or both"),
        ("", "", "missing"),
    ],
)
def test_list_with_a_wrong_entry_is_refused(tmp_path, old, new, says):
    path = tmp_path / "faults.yaml"
    path.write_text(ROW.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=says):
        load_faults(run.INJECTORS, path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("by: unreachable", "by: unreachible", "must be one of"),
        ("by: unreachable, door: closed", "by: unreachable, window: closed", "unexpected keyword|missing a required"),
    ],
)
def test_list_with_an_unknown_injector_or_parameter_is_refused(tmp_path, old, new, says):
    from tests.faults.catalogue import LIST

    path = tmp_path / "faults.yaml"
    text = LIST.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=says):
        load_faults(run.INJECTORS, path)
