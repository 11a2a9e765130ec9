"""Commands to the control process: which are executed, which are refused."""

import time

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.control import Cause, ControlLoop, RingLog, Segment, State, TableReference
from piezod.errors import CheckFailedError
from piezod.model import DirectDrive
from piezod.session import command_queue
from piezod.session.command_queue import CommandQueue
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
        pipe.waiting.append((7, time.monotonic_ns() - round(age_s * 1e9), name, argument))
        commands.notify()
        commands.serve_pending()
        return pipe.sent.pop()

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
    assert loop.supervisor.fast_ramp


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
    class Untouchable:
        def __getattr__(self, name):
            raise AssertionError(name)

    CommandQueue(None, None, Untouchable(), Untouchable(), None).serve_pending()
