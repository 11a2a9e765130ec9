"""The simulation itself: equal histories of a seed, and a judge that sees what is wrong."""

import importlib.util
import json
import struct
from pathlib import Path

import pytest

from piezod.control import Cause, State
from tests.simulation.holes import HOLES
from tests.simulation.plan import Event, Plan, draw
from tests.simulation.row_history import RowHistory
from tests.simulation.runs import run, warm_up
from tests.simulation.shrinking import shrink
from tests.simulation.trace import Trace


@pytest.fixture(scope="module", autouse=True)
def _warm():
    warm_up()


@pytest.mark.parametrize("seed", [1, 12, 1040])
def test_a_seed_has_one_history(seed):
    first, second = run(draw(seed, 6.0)), run(draw(seed, 6.0))
    assert first.violations == []
    assert first.digest == second.digest
    assert first.ticks == second.ticks > 0


def test_another_seed_has_another_history():
    assert run(draw(1, 5.0)).digest != run(draw(2, 5.0)).digest


def test_a_service_drives_after_arm_and_rests_after_disarm():
    result = run(Plan(1, 6.0, events=(Event(2.0, "arm"), Event(4.0, "disarm"))))
    assert result.violations == []
    states = [line.split(": ")[1] for line in result.log if line.split(": ")[1].isupper()]
    assert states == ["ARMING", "RUNNING", "RAMP_DOWN", "DISARMED"]
    assert 200 <= result.ticks <= 500  # two seconds of driving at 200 Hz, and the ramp down


def test_an_amplifier_that_stays_on_after_a_kill_is_a_violation():
    """Without its watchdog the device holds the output when the service is killed."""
    events = (Event(2.0, "arm"), Event(3.0, "watchdog", (0,)), Event(3.001, "kill_all"))
    result = run(Plan(1, 8.0, events=events))
    assert [kind for kind, *_ in result.violations] == ["rest"]


def request(voltage_V):
    """A Modbus/TCP request that writes the voltage register."""
    return b"\0\1\0\0\0\x0b\1\x10\0\x64\0\2\4" + struct.pack(">f", voltage_V)


RISEN = [(1, State.ARMING, Cause.ARMED, 20.0), (2, State.RUNNING, Cause.REFERENCE_REACHED, 30.0)]


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([*RISEN, (3, State.RAMP_DOWN, Cause.STOPPED, 29.0), (4, State.RAMP_DOWN, Cause.STOPPED, 28.0)], None),
        ([(1, State.DISARMED, Cause.NONE, 0.0)], "tick 1: 0.000 V sent in DISARMED, which writes nothing"),
        ([*RISEN, (3, State.FAULT, Cause.REFERENCE_LIVE, None)], "RUNNING -> FAULT by REFERENCE_LIVE: not in"),
        ([*RISEN, (3, State.DISARMED, Cause.STOPPED, None)], "RUNNING -> DISARMED by STOPPED: not in"),
        ([*RISEN, (3, State.HOLD, Cause.REFERENCE_STALE, 30.0), (4, State.HOLD, Cause.REFERENCE_STALE, 31.0)],
         "tick 4: 30.000 V, then 31.000 V sent in HOLD"),
        ([*RISEN, (3, State.RAMP_DOWN, Cause.OVER_FORCE, 29.0), (4, State.RAMP_DOWN, Cause.OVER_FORCE, 29.5)],
         "tick 4: 29.000 V, then 29.500 V sent in RAMP_DOWN"),
    ],
)  # fmt: skip
def test_rows_and_voltages_that_the_table_of_states_does_not_have_are_discrepancies(rows, text):
    found = []
    trace = Trace(found.append)
    for tick, state, cause, voltage_V in rows:
        if voltage_V is not None:
            trace.send(request(voltage_V), "tcp")
        trace.add(tick, state, cause)
    assert [one for one in found if text is None or text not in one] == []
    assert bool(found) == (text is not None)


@pytest.mark.parametrize("number", range(40))
def test_a_device_that_restarts_at_any_time_gets_no_voltage_of_before(number):
    """Found by seed 50329: the comparison between two ticks met the loss, and the next tick wrote 77 V at rest.

    Every 50 ms there is such a comparison: at 2.8400 s and at 2.8413 s the restart came shortly before one.
    """
    restart = Event(2.8 + 0.00125 * number, "restart_device")
    assert run(Plan(50329, 4.0, frequency_Hz=4.0, events=(Event(2.0, "arm"), restart))).violations == []


@pytest.mark.parametrize("way", [("urge", ("stop",)), ("urge", ("disarm",)), ("stop",), ("disarm",)])
@pytest.mark.parametrize("time_s", [0.5, 0.8, 0.95, 0.9644, 0.9645, 0.9646, 0.97, 1.05, 1.1])
def test_a_stop_while_the_service_starts_withdraws_the_arm_of_its_start(time_s, way):
    """The control process is connected at 0.9645 s and drives at 1.06 s: it must never drive for longer than a ramp."""
    start = (Event(0.0, "kill_all"), Event(0.1, "start", (True,)))
    result = run(Plan(1, 5.0, events=(*start, Event(time_s, *way))))
    assert result.violations == []
    assert not any("RUNNING" in line for line in result.log)


@pytest.mark.parametrize("time_s", [2.0, 2.0001, 2.001, 2.005, 2.01, 2.012, 2.0145, 2.02, 2.06, 2.3])
def test_a_signal_at_any_time_of_arming_ends_without_a_fault(time_s):
    """The watchdog of a device at rest has tripped, and the first command clears it."""
    result = run(Plan(1, 5.0, events=(Event(2.0, "arm"), Event(time_s, "signal_service", ("SIGTERM", 1)))))
    assert result.violations == []
    assert not any("FAULT" in line for line in result.log)


@pytest.mark.parametrize("name", ["ring.sock", "ring.sock.stop", "ring.lock"])
def test_a_removed_file_is_made_again_while_no_device_answers(name):
    events = (Event(1.5, "kill_all"), Event(1.6, "refuse_connections", (9.0,)), Event(1.7, "start"))
    assert run(Plan(1, 9.0, events=(*events, Event(4.0, "remove_files", (name,))))).violations == []


@pytest.mark.parametrize(("effects", "kinds"), [((), []), (("creep",), ["drift"])])
def test_only_a_bench_that_has_another_law_than_its_model_raises_an_alarm(effects, kinds):
    result = run(Plan(1, 16.0, drift=True, effects=effects, events=(Event(2.0, "arm"),)))
    assert [kind for kind, *_ in result.violations] == kinds


def test_a_polite_client_of_the_metrics_is_told_the_state_beside_impolite_ones():
    events = [Event(2.0, "arm"), Event(3.0, "scrape", (40, 1)), Event(3.1, "scrape", (40, 2)), Event(4.5, "stop")]
    events += [Event(1.0 + 0.31 * n, "scrape", (1, 0)) for n in range(16)]
    events = tuple(sorted(events, key=lambda event: event.time_s))
    result = run(Plan(1, 7.0, metrics=True, events=events))
    assert result.violations == []
    assert result.observed["scraped"] >= 10


@pytest.mark.parametrize("per_s", [-0.3, -0.6])
def test_a_reading_that_falls_while_the_reference_is_beyond_the_reach_of_the_stack_ends_the_drive(per_s):
    """At the rail the voltage cannot follow the error; the force trip rate is not reached."""
    falls = json.dumps([{"lie": {"kind": "gain_creep", "value": per_s}}])
    events = (Event(1.8, "stream", (340.0,)), Event(2.0, "arm"), Event(3.5, "steps", (falls,)))
    result = run(Plan(1, 7.0, reference="stream", events=events), make=RowHistory)
    assert result.violations == []
    assert result.observed["state"] == "FAULT"
    assert 0.0 < result.observed["after_ms"] < 3000.0


def test_shrinking_keeps_the_events_that_matter():
    extra = tuple(Event(2.0 + 0.05 * n, "status") for n in range(1, 8))
    needed = (Event(2.0, "arm"), Event(3.0, "watchdog", (0,)), Event(3.001, "kill_all"))
    plan = Plan(1, 8.0, events=tuple(sorted((*needed, *extra), key=lambda event: event.time_s)))
    assert shrink(plan, run(plan)).events == needed


def test_every_hole_has_its_place_in_the_source():
    for hole in HOLES.values():
        source = Path(importlib.util.find_spec(hole.module).origin).read_text(encoding="utf-8")
        assert source.count(hole.now) == 1, hole
