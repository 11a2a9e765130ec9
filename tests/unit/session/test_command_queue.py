"""Where the control process takes commands: what is obeyed, refused, and no longer obeyed."""

import time

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.control import Cause, ControlLoop, RingLog, Segment, State, TableReference
from piezod.errors import CheckFailedError
from piezod.model import DirectDrive
from piezod.session import control_process
from piezod.session.control_process import Desk
from tests.unit.control.fake_bench import FakeClock, FakeLink
from tests.unit.control.test_limits import limits


class Pipe:
    """The other end of the pipe, in this process."""

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
    """A desk, its loop, and a way to send it commands; every precondition holds unless told otherwise."""
    ring = RingLog(tmp_path / "ring", 1000)
    loop = ControlLoop(FakeLink(), limits(), FakeClock(), ring, 0.001, 200.0)
    pipe = Pipe()
    segment = Segment("hold", TableReference(np.full(10**5, 1.0)), DirectDrive(), follows_force=False)
    desk = Desk(load_bench(shipped("bench.yaml")), loop._link, loop, pipe, segment)
    monkeypatch.setattr(control_process, "check_ready", lambda bench, link: None)

    def command(name, argument=None, *, age_s=0.0):
        pipe.waiting.append((7, time.monotonic_ns() - round(age_s * 1e9), name, argument))
        desk.ring()
        desk.attend()
        return pipe.sent.pop()

    yield loop, command
    ring.close()


def test_an_arm_is_obeyed_and_answered_with_its_number(bench):
    loop, command = bench
    assert command("arm") == ("answer", (7, "ok", "arming"))
    assert loop.supervisor.state is State.ARMING


def test_an_arm_that_comes_late_is_refused_and_a_stop_never_is(bench):
    loop, command = bench
    _, (_, kind, text) = command("arm", age_s=6.0)
    assert kind == "CheckFailedError"
    assert "nobody may be waiting" in text
    assert loop.supervisor.state is State.DISARMED
    command("arm")
    assert command("stop", age_s=600.0)[1][1] == "ok"
    assert loop.supervisor.state is State.RAMP_DOWN
    assert loop.supervisor.fast_ramp


def test_a_precondition_that_does_not_hold_leaves_it_disarmed(bench, monkeypatch):
    loop, command = bench

    def refuse(*_):
        raise CheckFailedError("arming: no")

    monkeypatch.setattr(control_process, "check_ready", refuse)
    assert command("arm")[1][1:] == ("CheckFailedError", "arming: no")
    assert loop.supervisor.state is State.DISARMED


def test_only_a_reset_leaves_a_fault_and_nothing_arms_out_of_one(bench):
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


def test_without_a_ring_the_pipe_is_not_even_asked():
    class Untouchable:
        def __getattr__(self, name):
            raise AssertionError(name)

    Desk(None, None, Untouchable(), Untouchable(), None).attend()
