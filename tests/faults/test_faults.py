"""Every listed fault is injected and has its expected result."""

import inspect
import os
import signal
import time

import pytest

from piezod.errors import ConfigurationError
from tests.faults import run
from tests.faults.bench_pool import open_bench_pool
from tests.faults.catalogue import load_faults
from tests.faults.live_bench import DeviceProcess
from tests.faults.probe import STILL_MS, Probe
from tests.simulation.rows import rows

FAULTS = run.faults()
LIVE = {*run.ONLY_A_PROCESS_SHOWS.values()}
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


def listed(fault):
    """A fault as a parameter: without a process of its own a bench does not depend on the real clock."""
    if fault.injector in run.IN_PROCESS:
        return pytest.param(fault, id=fault.id)
    return pytest.param(fault, id=fault.id, marks=pytest.mark.real_time if fault.id in LIVE else pytest.mark.slow)


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


def test_every_fault_that_is_kept_live_runs_in_the_simulation_and_as_a_process():
    assert {*rows()} >= LIVE
    assert {fault.id for fault in FAULTS if fault.injector not in run.IN_PROCESS} >= LIVE
    assert len(LIVE) == len(run.ONLY_A_PROCESS_SHOWS) == 10


def test_nearly_every_listed_fault_is_injected_without_other_tests():
    assert len({*rows()} | {fault.id for fault in FAULTS if fault.injector != "checked"}) >= 170


@pytest.mark.slow
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
