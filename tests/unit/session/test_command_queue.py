"""Commands to the control process: which are executed, which are refused."""

from unittest.mock import MagicMock

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.control import Cause, ControlLoop, RingLog, Segment, State, TableReference
from piezod.control.authority import Demand
from piezod.errors import CheckFailedError
from piezod.model import DirectDrive
from piezod.session import command_queue
from piezod.session.command_queue import CommandQueue
from piezod.transport import ExchangeResult
from piezod.transport.status import STATUS_WATCHDOG
from tests.unit.control.fake_bench import FakeClock, FakeLink
from tests.unit.control.test_limits import limits


class Pipe:
    """A pipe in this process: `waiting` holds commands, `sent` holds answers."""

    def __init__(self):
        self.waiting, self.sent = [], []

    def poll(self):
        return bool(self.waiting)

    def recv(self):
        return self.waiting.pop(0)

    def send(self, message):
        self.sent.append(message)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A loop and a function that sends it a command; every precondition of arming holds."""
    ring_log = RingLog(tmp_path / "ring", 1000)
    loop = ControlLoop(FakeLink(), limits(), FakeClock(), ring_log, 0.001, 200.0)
    pipe = Pipe()
    segment = Segment("hold", TableReference(np.full(10**5, 1.0)), DirectDrive(), follows_force=False)
    commands = CommandQueue(load_bench(shipped("bench.yaml")), loop._link, loop, pipe, segment)
    monkeypatch.setattr(command_queue, "check_ready", lambda bench, link: None)

    def command(name, argument=None, *, age_s=0.0):
        pipe.waiting.append((7, command_queue.clock.monotonic_ns() - round(age_s * 1e9), name, argument))
        commands.notify()
        commands.serve_pending()
        return pipe.sent.pop()

    command.pipe, command.queue = pipe, commands
    yield loop, command
    ring_log.close()


def test_arm_is_executed_and_answered_with_its_number(bench):
    loop, command = bench
    assert command("arm") == ("answer", (7, "ok", "arming"))
    assert loop.supervisor.state is State.ARMING


def test_a_late_arm_is_refused_and_a_late_stop_is_executed(bench):
    loop, command = bench
    _, (_, kind, text) = command("arm", age_s=6.0)
    assert kind == "CheckFailedError"
    assert "must be at most 5 s" in text
    assert loop.supervisor.state is State.DISARMED
    command("arm")
    assert command("stop", age_s=600.0)[1][1] == "ok"
    assert loop.supervisor.state is State.RAMP_DOWN
    assert loop.supervisor.demand is Demand.STOP


def test_an_arm_whose_checks_last_too_long_is_refused_after_them(bench, monkeypatch):
    loop, command = bench
    clock = [0]
    monkeypatch.setattr(command_queue.clock, "monotonic_ns", lambda: clock[0])

    def slow_checks(*_):
        clock[0] += 5_100_000_000

    monkeypatch.setattr(command_queue, "check_ready", slow_checks)
    _, (_, kind, text) = command("arm")
    assert kind == "CheckFailedError"
    assert "must be at most 5 s" in text
    assert loop.supervisor.state is State.DISARMED


@pytest.mark.parametrize("name", ["arm", "reset", "limits", "end"])
def test_every_command_that_is_no_stop_expires(bench, name):
    loop, command = bench
    if name == "reset":
        command("arm")
        loop.supervisor.trip(Cause.DEVICE_WATCHDOG)
    before = loop.supervisor.state
    assert "must be at most 5 s" in command(name, limits(), age_s=5.1)[1][2]
    assert (loop.supervisor.state, loop.stopped) == (before, False)


def test_after_the_request_to_end_only_a_stop_is_executed(bench):
    loop, command = bench
    assert command("end")[1][1] == "ok"
    assert command("arm")[1][1] == "TemporaryError"
    assert command("stop")[1][1] == "ok"
    assert loop.supervisor.state is State.DISARMED


def test_a_stop_during_the_checks_of_an_arm_prevents_it(bench, monkeypatch):
    loop, command = bench
    monkeypatch.setattr(command_queue, "check_ready", lambda *_: loop.request_stop())
    assert command("arm")[1][1] == "TemporaryError"
    assert loop.supervisor.state is State.DISARMED


@pytest.mark.parametrize("broken", ["poll", "recv", "send"])
@pytest.mark.parametrize("error", [BrokenPipeError, ConnectionResetError, EOFError])
def test_the_death_of_the_parent_requests_a_stop_and_raises_nothing(bench, broken, error):
    loop, command = bench
    command("arm")

    def fail(*_):
        raise error

    setattr(command.pipe, broken, fail)
    command.pipe.waiting.append((8, command_queue.clock.monotonic_ns(), "limits", limits()))
    command.queue.notify()
    command.queue.serve_pending()
    assert loop.stopped
    loop.run_tick()
    assert loop.supervisor.state in (State.RAMP_DOWN, State.DISARMED)


def test_a_reset_is_refused_until_the_output_reads_back_at_rest(bench):
    loop, command = bench
    command("arm")
    loop.supervisor.trip(Cause.DEVICE_WATCHDOG)
    loop._readback_within_V = 2.0
    loop._link.reading.voltage_readback_V = 84.0
    assert "reads back 84 V" in command("reset")[1][2]
    assert loop.supervisor.state is State.FAULT
    loop._link.reading.voltage_readback_V = 1.9
    assert command("reset")[1][1] == "ok"


def test_a_failed_precondition_leaves_the_bench_disarmed(bench, monkeypatch):
    loop, command = bench

    def refuse(*_):
        raise CheckFailedError("arming: no")

    monkeypatch.setattr(command_queue, "check_ready", refuse)
    assert command("arm")[1][1:] == ("CheckFailedError", "arming: no")
    assert loop.supervisor.state is State.DISARMED


def test_only_reset_leaves_the_state_fault(bench):
    loop, command = bench
    command("arm")
    loop.supervisor.trip(Cause.DEVICE_WATCHDOG)
    assert loop.supervisor.state is State.FAULT
    for name in ("arm", "disarm", "stop", "end"):
        command(name)
        assert loop.supervisor.state is State.FAULT
    assert command("reset")[1][1] == "ok"
    assert loop.supervisor.state is State.DISARMED


def test_an_unknown_command_is_refused(bench):
    assert bench[1]("erase")[1][1] == "CheckFailedError"


def test_an_end_is_refused_while_driving(bench):
    loop, command = bench
    command("arm")
    assert command("end")[1][1] == "CheckFailedError"
    assert not loop.stopped


def test_without_a_notification_the_pipe_is_not_polled():
    pipe = MagicMock()
    CommandQueue(None, None, pipe, MagicMock(), None).serve_pending()
    assert pipe.mock_calls == []


def tripped_at(loop, command, output_V):
    """The loop in FAULT, while the output stands at a voltage, as behind a device that ignored the ramp."""
    command("arm")
    loop.supervisor.trip(Cause.READBACK)
    for _ in range(3000):
        loop.run_tick()
        loop._clock.wait()
    loop._link.written_V = loop._link.reading.voltage_readback_V = output_V
    loop._link.voltages.clear()
    assert (loop.supervisor.state, loop.at_rest) == (State.FAULT, False)


def test_a_stop_ramps_down_what_a_fault_has_left_and_the_fault_stays(bench):
    loop, command = bench
    loop._readback_within_V = 2.0
    tripped_at(loop, command, 60.0)
    assert command("stop") == ("answer", (7, "ok", "ramping down"))
    for _ in range(3000):
        loop.run_tick()
        loop._clock.wait()
    steps_V = np.diff([60.0, *loop._link.voltages])
    assert loop._link.voltages[-1] == pytest.approx(0.0, abs=1e-9)
    assert steps_V.min() >= -1.001 * limits().slew_V_per_s * 0.001
    assert steps_V.max() <= 0.0
    assert (loop.supervisor.state, loop.supervisor.fault) == (State.FAULT, Cause.READBACK)
    assert command("reset")[1][1] == "ok"


@pytest.mark.parametrize("prevented", ["watchdog", "no answer", "no readback", "at rest"])
def test_a_stop_writes_nothing_where_a_command_could_do_harm_or_nothing_is_left(bench, monkeypatch, prevented):
    loop, command = bench
    loop._readback_within_V = 2.0
    tripped_at(loop, command, 60.0)
    reading = loop._link.reading
    if prevented == "watchdog":
        reading.status |= STATUS_WATCHDOG
    elif prevented == "no answer":
        monkeypatch.setattr(loop._link, "poll", lambda: ExchangeResult.TIMEOUT)
    else:
        reading.voltage_readback_V = float("nan") if prevented == "no readback" else 1.0
    assert command("stop") == ("answer", (7, "ok", "FAULT: nothing is driven"))
    loop.run_tick()
    assert loop._link.voltages == []


@pytest.mark.parametrize("channel", ["pipe", "signal"])
def test_a_stop_refuses_every_arm_of_the_next_two_seconds(bench, monkeypatch, channel):
    loop, command = bench
    now_ns = [10**12]
    monkeypatch.setattr(command_queue.clock, "monotonic_ns", lambda: now_ns[0])
    if channel == "pipe":
        command("stop")
    else:
        command.queue.urge("stop")
    for after_ns in (760_000, 1_000_000_000, 1_999_000_000):
        now_ns[0] = 10**12 + after_ns
        assert "a stop came" in command("arm")[1][2]
        assert loop.supervisor.state is State.DISARMED
    now_ns[0] = 10**12 + 2_800_000_000
    assert command("arm")[1][1] == "ok"
