"""The control process and its parent: order of the start, signals, and a parent that is gone."""

import contextlib
import os
import signal
from types import SimpleNamespace

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.runtime import processes
from piezod.session import control_process
from piezod.session.session import Session
from piezod.session.task import SharedMemory, Task


@pytest.fixture
def steps(monkeypatch):
    """The steps of a start without a device, in their order."""
    found = []

    class Pipe:
        def send(self, message):
            found.append(message[0])

    loop = SimpleNamespace(
        observe=lambda *_: None,
        supervisor=SimpleNamespace(heat_W=0.0),
        serve=lambda _: found.append("serve"),
        request_stop=lambda *, fast=False: found.append("fast stop" if fast else "stop"),
    )
    link = SimpleNamespace(description="fake")
    monkeypatch.setattr(control_process, "opened_link", lambda *_: contextlib.nullcontext(link))
    monkeypatch.setattr(control_process, "_model_and_segments", lambda _: (None, ("segment",)))
    monkeypatch.setattr(control_process, "make_rate_keeper", lambda *_: SimpleNamespace(missed=0))
    segment = SimpleNamespace(reference=SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(control_process, "make_segment", lambda *_: segment)
    monkeypatch.setattr(control_process, "RingLog", lambda *_: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(control_process, "make_loop", lambda *_: loop)
    monkeypatch.setattr(control_process, "real_time", lambda _: contextlib.nullcontext())
    monkeypatch.setattr(control_process, "_warm_up", lambda _: found.append("warm up"))
    monkeypatch.setattr(control_process, "_outcome", lambda *_: loop)
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2)}
    yield SimpleNamespace(found=found, pipe=Pipe(), loop=loop)
    for number, handler in before.items():
        signal.signal(number, handler)


def execute(steps, heat_W=0.0):
    path = shipped("bench.yaml")
    task = Task(load_bench(path), None, path.parent, (), path, heat_W)
    control_process._execute(task, steps.pipe, SharedMemory(None))


def test_the_compiled_steps_are_loaded_before_ready(steps):
    execute(steps)
    assert steps.found == ["warm up", "ready", "serve"]


def test_every_sigterm_is_the_same_stop_and_haste_has_its_own_signal(steps):
    execute(steps)
    steps.found.clear()
    for number in (signal.SIGTERM, signal.SIGTERM, signal.SIGUSR2):
        os.kill(os.getpid(), number)
    assert steps.found == ["stop", "stop", "fast stop"]


def test_a_parent_that_is_gone_before_ready_requests_the_end(steps):
    def fail(_):
        raise BrokenPipeError

    steps.pipe.send = fail
    execute(steps)
    assert steps.found == ["warm up", "stop", "serve"]


def test_the_heat_of_the_control_process_before_is_kept(steps):
    execute(steps, heat_W=1.25)
    assert steps.loop.supervisor.heat_W == 1.25


def test_a_parent_that_died_before_its_signal_was_requested_is_noticed(monkeypatch):
    monkeypatch.setattr(processes.ctypes, "CDLL", lambda _: SimpleNamespace(prctl=lambda *_: 0))
    for parent_pid, lives in ((os.getppid(), True), (os.getppid() + 1, False)):
        monkeypatch.setattr(
            processes.multiprocessing, "parent_process", lambda pid=parent_pid: SimpleNamespace(pid=pid)
        )
        assert processes.end_with_parent(signal.SIGTERM) is lives


def test_only_a_second_stop_is_hasty_and_closing_never_is(tmp_path, monkeypatch):
    bench = load_bench(shipped("bench.yaml"))
    session = Session(Task(bench, None, shipped("bench.yaml").parent, ()), SimpleNamespace())
    sent = []
    monkeypatch.setattr(session, "_signal", sent.append)
    session.stop()
    session._process = SimpleNamespace(join=lambda timeout: None, is_alive=lambda: False)
    monkeypatch.setattr(type(bench), "ring_log_path", tmp_path / "ring")
    session.close()
    session.stop()
    assert sent == [signal.SIGTERM, signal.SIGTERM, signal.SIGUSR2]
