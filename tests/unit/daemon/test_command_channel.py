"""The channel to the control process: which command waits, and what an answer that does not come leaves behind."""

import asyncio

import pytest

from piezod.daemon import command_channel
from piezod.daemon.command_channel import CommandChannel
from piezod.errors import TemporaryError


class SilentSession:
    """A session whose control process answers only the commands in `answers`."""

    def __init__(self, answers=()):
        self.answers, self.commands, self.channel = answers, [], None

    def command(self, name, argument=None, requested_ns=None):
        self.commands.append((name, requested_ns))
        number = len(self.commands)
        if name in self.answers:
            loop = asyncio.get_running_loop()
            loop.call_soon(lambda: self.channel._resolve(number, ("ok", name)))
        return number


@pytest.fixture
def connected(monkeypatch):
    monkeypatch.setattr(command_channel, "ANSWER_WITHIN_S", 0.02)
    session = SilentSession(("stop", "disarm"))
    session.channel = CommandChannel(session)
    session.channel.connected = True
    return session.channel, session


@pytest.mark.parametrize(("name", "sent"), [("arm", ["arm", "disarm"]), ("limits", ["limits"])])
def test_an_arm_without_an_answer_is_taken_back(connected, name, sent):
    channel, session = connected
    with pytest.raises(TemporaryError, match="did not answer"):
        asyncio.run(channel.send(name, settle_s=0.0))
    assert [command for command, _ in session.commands] == sent


def test_a_stop_does_not_wait_for_the_answer_to_an_arm(connected):
    channel, session = connected

    async def scenario():
        arm = asyncio.create_task(channel.send("arm", settle_s=0.0))
        await asyncio.sleep(0)
        assert await channel.send("stop", settle_s=0.0) == "stop"
        assert not arm.done()
        with pytest.raises(TemporaryError):
            await arm

    asyncio.run(scenario())
    assert [command for command, _ in session.commands] == ["arm", "stop", "disarm"]


def test_a_command_expires_from_its_request_on_and_not_from_its_turn(connected, monkeypatch):
    channel, session = connected
    session.answers = ("arm", "reset")
    clock = [1_000]
    monkeypatch.setattr(command_channel.clock, "monotonic_ns", lambda: clock[0])

    async def scenario():
        async with channel._lock:
            waiting = asyncio.create_task(channel.send("reset", settle_s=0.0))
            await asyncio.sleep(0)
            clock[0] = 9_000
        await waiting

    asyncio.run(scenario())
    assert session.commands == [("reset", 1_000)]


def test_no_command_is_sent_to_a_control_process_that_has_ended(connected):
    channel, session = connected
    channel.ended = True
    with pytest.raises(TemporaryError, match="has ended"):
        asyncio.run(channel.send("arm", settle_s=0.0))
    assert session.commands == []
