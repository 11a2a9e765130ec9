"""A stop never raises an output, and a slow tick reads before it writes."""

import pytest

from piezod.control import State
from piezod.control.limits import Limiter
from piezod.control.states import Cause
from piezod.control.supervisor import Supervisor
from piezod.control.voltage_writer import READ_FIRST_S, VoltageWriter
from piezod.transport import ExchangeResult
from tests.unit.control.fake_bench import FakeClock, FakeLink
from tests.unit.control.loops import make_loop
from tests.unit.control.test_limits import limits


@pytest.mark.parametrize(("output_V", "driven"), [(0.0, False), (10.0, False), (20.0, False), (60.0, True)])
def test_a_stop_lowers_an_output_that_stands_and_raises_none(ring_log, output_V, driven):
    link = FakeLink()
    loop = make_loop(link, ring_log, voltage_min_V=20.0)
    link.reading.voltage_readback_V = output_V
    loop._readback_within_V = 2.0  # as a bench file sets it
    loop.bring_down_left_output()
    assert (loop.supervisor.state is State.RAMP_DOWN) == driven


def writer(dt_s):
    """A writer at 80 V on a link that counts its reads."""
    link, clock = FakeLink(), FakeClock(round(1e9 * dt_s))
    link.polls = []
    link.poll = lambda: link.polls.append(link.written_V) or ExchangeResult.OK
    bench = limits(slew_V_per_s=4000.0, device_watchdog_ms=0, comm_loss_ms=2000.0)
    supervisor = Supervisor(bench, dt_s)
    supervisor.arm(0)
    made = VoltageWriter(link, Limiter(bench, dt_s), supervisor, clock, bench, dt_s, readback_within_V=2.0)
    made.start_from(80.0)
    link.reading.voltage_readback_V = 80.0
    return made, link, clock, supervisor


@pytest.mark.parametrize(("dt_s", "reads"), [(0.1, 3), (READ_FIRST_S, 3), (0.01, 0)])
def test_only_slow_ticks_read_before_they_write(dt_s, reads):
    made, link, clock, _ = writer(dt_s)
    for _ in range(3):
        link.reading.voltage_readback_V = 80.0
        made.write(80.0, clock.now_ns())
        clock.wait()
    assert len(link.polls) == reads
    assert link.voltages == [80.0] * 3


def test_a_device_that_restarted_between_two_slow_ticks_gets_no_voltage():
    made, link, clock, supervisor = writer(0.1)
    made.write(80.0, clock.now_ns())
    clock.wait()
    link.reading.voltage_readback_V = 0.0
    made.write(80.0, clock.now_ns())
    assert supervisor.fault is Cause.DEVICE_RESTARTED
    assert link.voltages == [80.0]
