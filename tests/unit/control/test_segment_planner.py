"""The segment planner: it reports events and leaves the state to the loop."""

import numpy as np
import pytest

from piezod.control import Cause, Segment, State, TableReference
from piezod.control.limits import Limiter
from piezod.control.references import Freshness
from piezod.control.segment_planner import SegmentPlanner
from piezod.control.supervisor import Supervisor
from tests.unit.control.loops import DT_S, Halving
from tests.unit.control.test_limits import limits

SAFE_V, APPROACH_V = 0.0, 0.2


def planner_in(state, applied_V=10.0, **arguments):
    supervisor, limiter = Supervisor(limits()), Limiter(limits(), DT_S)
    limiter.applied_V = applied_V
    planner = SegmentPlanner(limiter, supervisor, None, APPROACH_V)
    planner.begin(Segment("work", TableReference(np.full(5, 20.0), **arguments), Halving()), 0)
    supervisor.arm(0)
    supervisor.state = state
    return planner, supervisor


@pytest.mark.parametrize(
    ("state", "applied_V", "event", "expected_N"),
    [
        (State.ARMING, 5.0, Cause.NONE, False),
        (State.ARMING, 9.9, Cause.REFERENCE_REACHED, True),
        (State.RUNNING, 10.0, Cause.NONE, True),
        (State.HOLD, 10.0, Cause.REFERENCE_LIVE, True),
    ],
)
def test_a_live_reference_is_planned_and_its_event_reported_without_a_change_of_state(
    state, applied_V, event, expected_N
):
    planner, supervisor = planner_in(state, applied_V)
    assert planner.plan_voltage(1, 0, SAFE_V) == 10.0
    assert planner.event is event
    assert np.isfinite(planner.expected_force_N) == expected_N
    assert supervisor.state is state


@pytest.mark.parametrize(("ramp_down", "voltage_V"), [(True, SAFE_V), (False, 10.0)])
@pytest.mark.parametrize(
    ("freshness", "event"), [(Freshness.ENDED, Cause.REFERENCE_ENDED), (Freshness.STALE, Cause.REFERENCE_STALE)]
)
def test_a_lapsed_reference_is_reported_without_a_change_of_state(freshness, event, ramp_down, voltage_V):
    planner, supervisor = planner_in(State.RUNNING, ramp_down_on_lapse=ramp_down)
    reference = planner.segment.reference
    reference.read = lambda *_: setattr(reference, "freshness", freshness) or 20.0
    assert planner.plan_voltage(1, 0, SAFE_V) == voltage_V
    assert planner.event is event
    assert np.isnan(planner.expected_force_N)
    assert supervisor.state is State.RUNNING


@pytest.mark.parametrize("state", [State.DISARMED, State.RAMP_DOWN, State.FAULT])
def test_the_safe_voltage_is_planned_while_no_segment_is_driven(state):
    planner, _ = planner_in(state)
    assert planner.plan_voltage(1, 0, SAFE_V) == SAFE_V
    assert planner.event is Cause.NONE


class Counting(TableReference):
    """A reference that lists its calls."""

    def __init__(self):
        super().__init__(np.full(5, 20.0))
        self.calls = []

    def begin(self):
        self.calls.append("begin")

    def idle(self, now_ns):
        self.calls.append("idle")

    def read(self, tick, now_ns):
        self.calls.append("read")
        return super().read(tick, now_ns)


def test_every_tick_receives_the_values_of_the_reference_also_at_rest_and_before_the_first_arming():
    supervisor, limiter = Supervisor(limits()), Limiter(limits(), DT_S)
    planner, reference = SegmentPlanner(limiter, supervisor, None, APPROACH_V), Counting()
    planner.observe(reference)
    planner.plan_voltage(0, 0, SAFE_V)
    cycle = TableReference([0.0])
    planner.begin(Segment("work", reference, Halving(), cycle), 1)
    supervisor.arm(0)
    for tick in range(1, 4):
        planner.plan_voltage(tick, 0, SAFE_V)
    for state in (State.RUNNING, State.RAMP_DOWN, State.FAULT, State.DISARMED):
        supervisor.state = state
        planner.plan_voltage(4, 0, SAFE_V)
    supervisor.state, supervisor.readings_stale = State.RUNNING, True
    planner.plan_voltage(5, 0, SAFE_V)
    assert reference.calls == ["idle", "begin", "idle", "read", "read", "read", "idle", "idle", "idle", "idle"]
