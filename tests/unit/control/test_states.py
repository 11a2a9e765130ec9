"""The table of states: what may come, what may be written, and where the manual shows it."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from piezod.control import Cause, Segment, State, TableReference
from piezod.control.states import DRIVING, MAY_WRITE, TRANSITIONS, Event, Write
from piezod.control.supervisor import Supervisor
from piezod.errors import CheckFailedError
from piezod.model import DirectDrive
from tests.unit.control.fake_bench import FakeLink
from tests.unit.control.loops import make_loop
from tests.unit.control.test_limits import limits

MANUAL = Path(__file__).parents[3] / "systemd" / "README.md"
CALLS = {
    Event.ARM: lambda supervisor: supervisor.arm(0),
    Event.REACHED: Supervisor.start_running,
    Event.LAPSED: lambda supervisor: supervisor.apply(Event.LAPSED, Cause.REFERENCE_STALE),
    Event.LIVE: lambda supervisor: supervisor.apply(Event.LIVE, Cause.REFERENCE_LIVE),
    Event.STOP: Supervisor.stop,
    Event.TRIP: lambda supervisor: supervisor.trip(Cause.COMM_LOSS),
    Event.AT_REST: Supervisor.end_ramp_down,
    Event.LATCHED: Supervisor.end_ramp_down,
    Event.RESET: lambda supervisor: supervisor.reset(at_rest=True),
    Event.LEFT: lambda supervisor: supervisor.bring_down(0),
}
WAYS = {
    State.DISARMED: (),
    State.ARMING: (Event.ARM,),
    State.RUNNING: (Event.ARM, Event.REACHED),
    State.HOLD: (Event.ARM, Event.REACHED, Event.LAPSED),
    State.RAMP_DOWN: (Event.ARM, Event.STOP),
    State.FAULT: (Event.ARM, Event.TRIP, Event.LATCHED),
}


def in_state(state, event):
    supervisor = Supervisor(limits())
    for one in WAYS[state] if (state, event) != (State.RAMP_DOWN, Event.LATCHED) else (Event.ARM, Event.TRIP):
        CALLS[one](supervisor)
    assert supervisor.state is state
    return supervisor


@pytest.mark.parametrize(("state", "event"), list(product(State, Event)), ids=lambda one: one.name)
def test_an_event_leads_where_the_table_says_and_one_that_it_lacks_raises_and_changes_nothing(state, event):
    supervisor = in_state(state, event)
    before = {name: value for name, value in vars(supervisor).items() if not name.startswith("__")}
    if (state, event) in TRANSITIONS:
        CALLS[event](supervisor)
        assert supervisor.state is TRANSITIONS[state, event]
    elif event is Event.LATCHED and state is State.RAMP_DOWN:
        pytest.skip("one method, with or without a latched fault")
    else:
        with pytest.raises(CheckFailedError, match=f"may not come in state {state.name}"):
            CALLS[event](supervisor)
        assert vars(supervisor) == before


def test_every_state_that_writes_can_be_stopped_and_can_trip():
    for state in DRIVING:
        assert TRANSITIONS[state, Event.STOP] is TRANSITIONS[state, Event.TRIP] is State.RAMP_DOWN


def test_only_an_operator_leaves_the_states_that_write_nothing():
    for state in set(State) - set(DRIVING):
        assert MAY_WRITE[state] is Write.NOTHING
        leaving = {event for (before, event), after in TRANSITIONS.items() if before is state is not after}
        assert leaving <= {Event.ARM, Event.RESET, Event.LEFT}


def test_an_event_that_the_table_lacks_is_a_fault_of_the_controller_and_ramps_down(ring_log, monkeypatch):
    link = FakeLink()
    loop = make_loop(link, ring_log)
    loop.arm(Segment("hold", TableReference(np.full(10**5, 50.0)), DirectDrive(), follows_force=False))
    for _ in range(600):
        loop.run_tick()
        loop.wait()
    assert loop.supervisor.state is State.RUNNING
    monkeypatch.setattr(loop, "_act_on", lambda _: loop.supervisor.apply(Event.LIVE, Cause.REFERENCE_LIVE))
    loop.run_tick()
    monkeypatch.undo()
    assert loop.supervisor.fault is Cause.CONTROLLER
    assert "reference live: may not come in state RUNNING" in loop.failure
    for _ in range(600):
        loop.run_tick()
        loop.wait()
    assert loop.supervisor.state is State.FAULT
    assert link.voltages[-1] == pytest.approx(0.0, abs=1e-9)


def test_the_manual_shows_the_table():
    lines = ["| state | writes | event: next state |", "|---|---|---|"]
    for state in State:
        events = {}
        for (before, event), after in TRANSITIONS.items():
            if before is state is not after:
                events.setdefault(after.name, []).append(event.value)
        shown = "; ".join(f"{', '.join(names)}: {after}" for after, names in events.items())
        lines.append(f"| {state.name} | {MAY_WRITE[state].value} | {shown} |")
    assert "\n".join(lines) in MANUAL.read_text(encoding="utf-8")
