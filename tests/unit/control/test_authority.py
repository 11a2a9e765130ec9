"""The order of authority: which demand wins, and how fast the output then moves."""

from itertools import combinations
from math import ceil

import numpy as np
import pytest

from piezod.control import Cause, Segment, State, TableReference
from piezod.control.authority import AUTHORITY, Demand
from tests.unit.control.fake_bench import FakeLink
from tests.unit.control.loops import Halving, make_loop

SLEW_V, RAMP_V = 4.0, 0.4  # largest change in a tick at the limits of `make_loop`
FALL_V = {
    Demand.STOP: SLEW_V,
    Demand.DANGER: SLEW_V,
    Demand.FAULT: RAMP_V,
    Demand.SUSPECT: RAMP_V,
    Demand.DISARM: RAMP_V,
    Demand.REFERENCE: 0.0,
}


def make(demand, loop, link):
    """Make a demand on a running loop."""
    supervisor = loop.supervisor
    match demand:
        case Demand.STOP:
            loop.request_stop(fast=True)
        case Demand.DANGER:
            supervisor.trip(Cause.OVER_FORCE)
        case Demand.FAULT:
            supervisor.trip(Cause.COMM_LOSS)
        case Demand.SUSPECT:
            link.plant = lambda voltage_V: 400.0
            loop.tick()
            loop._clock.wait()
        case Demand.DISARM:
            loop.request_stop()


def at_50_V(ring_log, **changes):
    link = FakeLink(lambda voltage_V: 1.0)
    loop = make_loop(link, ring_log, force_debounce_samples=100, **changes)
    loop.begin(Segment("long", TableReference(np.full(10**5, 100.0)), Halving()))
    loop.supervisor.arm(0)
    for _ in range(600):
        loop.tick()
        loop._clock.wait()
    assert link.voltages[-1] == pytest.approx(50.0)
    return loop, link


def largest_fall_V(loop, link, ticks=5):
    """Largest fall of the next ticks [V]."""
    first = len(link.voltages) - 1
    for _ in range(ticks):
        loop.tick()
        loop._clock.wait()
    return -np.diff(link.voltages[first:]).min()


@pytest.mark.parametrize("pair", list(combinations(Demand, 2)), ids=lambda pair: "-".join(d.name for d in pair))
@pytest.mark.parametrize("winner_first", [True, False])
def test_of_two_demands_that_with_more_authority_sets_the_rate(ring_log, pair, winner_first):
    if {*pair} == {Demand.DANGER, Demand.FAULT}:
        pytest.skip("the first fault is latched; a second one changes nothing")
    loop, link = at_50_V(ring_log)
    for demand in pair if winner_first else pair[::-1]:
        make(demand, loop, link)
    assert largest_fall_V(loop, link) == pytest.approx(FALL_V[pair[0]])
    assert loop.supervisor.demand is pair[0]


def test_no_demand_moves_the_output_slower_than_one_with_less_authority():
    speeds = [FALL_V[demand] for demand in AUTHORITY]
    assert list(AUTHORITY) == sorted(Demand)
    assert speeds == sorted(speeds, reverse=True)


@pytest.mark.parametrize("ramp_down_V_per_s", [400.0, 2.0, 0.1])
@pytest.mark.parametrize("force_N", [1.0, 400.0, -100.0])
def test_a_stop_takes_as_long_with_a_force_beyond_its_limits_as_without(ring_log, force_N, ramp_down_V_per_s):
    loop, link = at_50_V(ring_log, ramp_down_V_per_s=ramp_down_V_per_s)
    link.plant = lambda voltage_V: force_N
    loop.request_stop(fast=True)
    assert _ticks_to_rest(loop) == ceil(50.0 / SLEW_V)


@pytest.mark.parametrize("cause", [Cause.OVER_FORCE, Cause.FORCE_RATE, Cause.READBACK, Cause.COMM_LOSS, None])
def test_the_output_rises_no_more_after_a_stop_or_a_fault(ring_log, cause):
    loop, link = rising_at_60_V(ring_log, lambda voltage_V: 1.0)
    if cause is None:
        loop.request_stop(fast=True)
    else:
        loop.supervisor.trip(cause)
    tripped = len(link.voltages) - 1
    _ticks_to_rest(loop)
    assert np.diff(link.voltages[tripped:]).max() <= 0.0


def rising_at_60_V(ring_log, plant, **changes):
    """A loop whose output rises through 60 V by 0.3 V a tick and more."""
    link = FakeLink(plant)
    loop = make_loop(link, ring_log, acceleration_V_per_s2=2000.0, **changes)
    loop.begin(Segment("long", TableReference(np.full(10**5, 280.0)), Halving()))
    loop.supervisor.arm(0)
    loop._planner._approach_V = 4.0
    while link.written_V < 60.0:
        loop.tick()
        loop._clock.wait()
    assert loop.limiter._last_change_V > 0.3
    return loop, link


@pytest.mark.parametrize("cause", [Cause.OVER_FORCE, Cause.FORCE_RATE, Cause.READBACK, Cause.COMM_LOSS, None])
@pytest.mark.parametrize("deceleration_V_per_s2", [2000.0, 8000.0, 1e5])
def test_a_stop_or_a_fault_turns_the_output_at_its_own_deceleration(ring_log, cause, deceleration_V_per_s2):
    loop, link = rising_at_60_V(ring_log, lambda voltage_V: 1.0, deceleration_V_per_s2=deceleration_V_per_s2)
    way_V, begin_V = loop.limiter.braking_V, link.written_V
    if cause is None:
        loop.request_stop(fast=True)
    else:
        loop.supervisor.trip(cause)
    tripped = len(link.voltages) - 2
    _ticks_to_rest(loop)
    voltages_V = np.array(link.voltages[tripped:])
    changes_V = np.diff(voltages_V, 2)[voltages_V[2:] > 1.0]  # the last change ends at the end of the range
    assert np.abs(changes_V).max() <= deceleration_V_per_s2 * 1e-6 + 1e-9
    assert voltages_V.max() - begin_V == pytest.approx(way_V, abs=deceleration_V_per_s2 * 1e-6)
    assert voltages_V[-1] == 0.0


@pytest.mark.parametrize("deceleration_V_per_s2", [4000.0, 8000.0, None])
def test_a_force_trip_counts_the_way_that_the_output_still_rises(ring_log, deceleration_V_per_s2):
    changes = {"deceleration_V_per_s2": deceleration_V_per_s2, "force_trip_N": 240.0, "force_debounce_samples": 1}
    loop, link = rising_at_60_V(ring_log, lambda voltage_V: 3.0 * voltage_V, **changes)
    while loop.supervisor.fault is Cause.NONE:
        loop.tick()
        loop._clock.wait()
    trip_V = link.voltages[-1]
    _ticks_to_rest(loop)
    tick_N = 3.0 * 0.75
    assert loop.supervisor.fault is Cause.OVER_FORCE
    assert 240.0 - 2.0 * tick_N <= 3.0 * max(link.voltages) <= 240.0 + tick_N
    assert (3.0 * trip_V < 230.0) is (deceleration_V_per_s2 is not None)


def test_a_falling_output_counts_no_way_to_brake(ring_log):
    loop, link = rising_at_60_V(ring_log, lambda voltage_V: 3.0 * voltage_V, deceleration_V_per_s2=2000.0)
    loop.request_stop(fast=True)
    while link.voltages[-1] >= link.voltages[-2]:
        loop.tick()
        loop._clock.wait()
    assert loop.limiter.braking_V == 0.0


def test_a_disarm_begins_within_the_acceleration_limit(ring_log):
    loop, link = at_50_V(ring_log, acceleration_V_per_s2=2000.0)
    disarmed = len(link.voltages) - 1
    loop.request_stop()
    assert largest_fall_V(loop, link, 100) == pytest.approx(0.2)
    assert np.abs(np.diff(link.voltages[disarmed - 1 :], 2)).max() <= 0.002 + 1e-9


def _ticks_to_rest(loop):
    ticks = 0
    while loop.supervisor.state is not State.DISARMED and loop.supervisor.driving and ticks < 10_000:
        loop.tick()
        loop._clock.wait()
        ticks += 1
    return ticks
