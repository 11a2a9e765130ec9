"""Repairs of removed files, and the answer to a stop whose service does not answer any more."""

import asyncio
import socket

import pytest

from piezod.control import State
from piezod.daemon import client
from piezod.daemon import service as service_module
from piezod.daemon.service import DRIVING, Service
from piezod.errors import TemporaryError, UnreachableError


class Files:
    """Each step of a repair; `fails` names those that cannot be made."""

    def __init__(self, *, lock_is_free=True, fails=()):
        self.lock_is_free, self.fails, self.made = lock_is_free, fails, []

    def make(self, name):
        if name in self.fails:
            raise TemporaryError(f"{name}: no space")
        self.made.append(name)
        return True


def service_of(files):
    service = Service.__new__(Service)
    service._lock_lost, service._files_problem, service._stops_requested = False, "", 0
    service._wake = asyncio.Event()
    service._bench = type("Bench", (), {"name": "bench"})

    async def step(name):
        return files.make(name)

    def lock():
        files.make("lock")
        return files.lock_is_free

    service._lock = type("Lock", (), {"restore": staticmethod(lock)})
    service._control_socket = type("Socket", (), {"restore": lambda _: step("socket")})()
    service._restore_stop_path = lambda _: step("stop socket")
    service._restore_ring_log = lambda _: step("ring log")
    return service


STEPS = ["lock", "socket", "stop socket", "ring log"]


@pytest.mark.parametrize("failing", STEPS)
def test_a_file_that_cannot_be_made_prevents_no_other_one(failing):
    files = Files(fails=(failing,))
    asyncio.run(service_of(files)._restore_files(None))
    assert files.made == [name for name in STEPS if name != failing]


def test_a_service_whose_bench_another_program_has_makes_none_of_its_files():
    files = Files(lock_is_free=False)
    service = service_of(files)
    asyncio.run(service._restore_files(None))
    assert files.made == ["lock"]
    assert service._stops_requested == 1


def test_every_state_that_stays_at_a_voltage_counts_as_driven_where_no_stop_can_come():
    assert set(DRIVING) == set(State) - {State.DISARMED, State.FAULT, State.RAMP_DOWN}
    assert service_module.UNSTOPPABLE_S < 2.0


@pytest.mark.parametrize("is_there", [True, False])
def test_a_stop_is_complete_only_where_its_service_has_removed_its_socket(tmp_path, monkeypatch, is_there):
    """The control socket does not answer: the command has ended, or a daemon hangs."""
    path = tmp_path / "ring.sock"
    monkeypatch.setattr(client, "urge", lambda *_: "stop: passed to the control process")
    if not is_there:
        answer = client.command_and_wait(path, "stop", wait=True)
        assert answer["message"].endswith("the command that drove has ended")
        return
    with socket.socket(socket.AF_UNIX) as stands:
        stands.bind(str(tmp_path / "ring.sock.stop"))
        with pytest.raises(UnreachableError, match="is the daemon running"):
            client.command_and_wait(path, "stop", wait=True)
