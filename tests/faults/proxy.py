"""A wire with faults between daemon and device, over TCP or between two pseudo-terminals.

    daemon  <->  proxy  <->  device

The proxy passes whole frames. Rules say what it does to some of them; `act` does something to the connection at once.
Everything that it did stands in `done`, with the time.
"""

import asyncio
import contextlib
import os
import random
import socket
import struct
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tests.faults.forgeries import forged

Way = Literal["request", "reply"]
ACTIONS = (
    "delay",  # pass it on `by` seconds later, and what follows after it
    "drop",
    "duplicate",  # twice in one segment
    "split",  # byte by byte, each a segment
    "corrupt",  # one bit in the middle is wrong
    "reset",  # the connection, instead of passing the frame
    "close",
    "half_open",  # from here on nothing passes, and nobody is told
    "stall",  # nothing passes for `by` seconds, either way, then everything
    "lag",  # each is held until the next one of its way comes
    "forge",  # a reply of `kind` instead
    "noise",  # three bytes before, two behind
    "echo",  # a request comes back to the one who sent it, before its reply
    "throttle",  # `by` bytes a second
    "random",  # random bytes instead, as many as there were or more
)
NOISE = (b"\x55\x00\xff", b"\xaa\x7e")
READ_BYTES = 4096
ROUNDED_S = 0.0015


@dataclass
class Rule:
    """What is done to some frames.

    Parameters
    ----------
    do
        One of `DOES`.
    way
        To requests or to replies.
    after
        Frames of that way that pass untouched first.
    count
        Frames that it is done to; 0: all from then on.
    by
        Seconds, or bytes a second.
    kind
        Of a forgery.
    """

    do: str
    way: Way = "reply"
    after: int = 0
    count: int = 1
    by: float = 0.0
    kind: str = ""

    def __post_init__(self) -> None:
        if self.do not in ACTIONS:
            raise ValueError(f"rule is {self.do!r}, must be one of {', '.join(ACTIONS)}")
        self._seen = 0

    def takes(self, way: Way) -> bool:
        """Whether this frame is one of its frames; counts it."""
        if way != self.way:
            return False
        self._seen += 1
        behind = self._seen - self.after
        return behind > 0 and (self.count == 0 or behind <= self.count)


@dataclass(frozen=True)
class ProxyAction:
    """Something that the proxy did: when (monotonic [ns]), what, and to which frame of its way."""

    time_ns: int
    do: str
    way: str
    frame: str


class _Wire:
    """What every proxy does with a frame, whatever carries it."""

    framing = "tcp"

    def __init__(self) -> None:
        self.rules: list[Rule] = []
        self.done: list[ProxyAction] = []
        self.passed = 0
        self.late_s = 0.0  # by how much more than asked for a frame was held back at most
        self._before = b""
        self._forged = 0
        self._random = random.Random(1)
        self._flowing = asyncio.Event()
        self._flowing.set()

    def schedule(self, rules: list[Rule]) -> None:
        """Do this from now on; what was scheduled before is over."""
        self.rules = rules
        self._flowing.set()

    def note(self, do: str, way: str = "", frame: bytes = b"") -> None:
        """Keep what was done."""
        self.done.append(ProxyAction(time.monotonic_ns(), do, way, frame.hex()))

    def stall(self, duration_s: float) -> None:
        """Let nothing pass for a while."""
        self.note("stall")
        self._flowing.clear()
        asyncio.get_running_loop().call_later(duration_s, self._flowing.set)

    async def carry(self, frame: bytes, way: Way, line: "_Line") -> None:
        """Pass a frame on, or do to it what a rule says."""
        await self._flowing.wait()
        rule = self._rule(way)
        if way == "reply":
            before, self._before = self._before, frame
        else:
            before = b""
        if rule is None:
            self.passed += 1
            line.send(frame, way)
            return
        self.note(rule.do, way, frame)
        await self._do(rule, frame, before, way, line)

    def _rule(self, way: Way) -> Rule | None:
        """The first rule that takes the frame; all of them count it."""
        taken = [rule for rule in self.rules if rule.takes(way)]
        return taken[0] if taken else None

    async def _do(self, rule: Rule, frame: bytes, before: bytes, way: Way, line: "_Line") -> None:
        """What is done in time, or to the connection; the frame itself is changed by `_changed`."""
        match rule.do:
            case "reset" | "close" | "half_open":
                line.act(rule.do)
            case "delay" | "throttle":
                late_s = await _pause(rule.by if rule.do == "delay" else len(frame) / rule.by)
                self.late_s = max(self.late_s, late_s)
                line.send(frame, way)
            case "stall":
                self.stall(rule.by)
                await self._flowing.wait()
                line.send(frame, way)
            case "lag":
                held, line.held[way] = line.held.get(way, b""), frame
                line.send(held, way)
            case "echo":
                line.send(frame, "reply")
                line.send(frame, "request")
            case _:
                for part in self._changed(rule, frame, before):
                    line.send(part, way)
                    await asyncio.sleep(0)  # a segment each

    def _changed(self, rule: Rule, frame: bytes, before: bytes) -> list[bytes]:
        """The segments that are sent instead of a frame."""
        if rule.do == "forge" and before:
            self._forged += 1
            return [forged(rule.kind, frame, before, self._forged - 1, framing=self.framing)]
        at = len(frame) // 2
        changes: dict[str, Callable[[], list[bytes]]] = {
            "drop": list,
            "duplicate": lambda: [frame + frame],
            "split": lambda: [frame[k : k + 1] for k in range(len(frame))],
            "corrupt": lambda: [frame[:at] + bytes((frame[at] ^ 0x10,)) + frame[at + 1 :]],
            "noise": lambda: [NOISE[0] + frame + NOISE[1]],
            "random": lambda: [self._random.randbytes(len(frame) + self._random.randrange(40))],
        }
        return changes.get(rule.do, lambda: [frame])()


async def _pause(duration_s: float) -> float:
    """Let so much time pass: asyncio alone rounds up to whole milliseconds, which is a good part of a tick.

    Returns by how much it was more [s].
    """
    end_s = time.monotonic() + duration_s
    if duration_s > ROUNDED_S:
        await asyncio.sleep(duration_s - ROUNDED_S)
    while time.monotonic() < end_s:  # noqa: ASYNC110  # nothing sets an event for the passing of time
        await asyncio.sleep(0)
    return time.monotonic() - end_s


class _Line:
    """One connection through the proxy."""

    def __init__(self, send: Callable[[bytes, Way], None], act: Callable[[str], None]) -> None:
        self._send, self._act = send, act
        self.held: dict[str, bytes] = {}
        self.dead = False

    def send(self, data: bytes, way: Way) -> None:
        """Towards the device, or back."""
        if data and not self.dead:
            self._send(data, way)

    def act(self, what: str) -> None:
        """End it, or let it fall silent."""
        if what == "half_open":
            self.dead = True
        else:
            self._act(what)


class TcpProxy(_Wire):
    """Listens where the daemon connects, and connects to the device.

    Parameters
    ----------
    upstream
        Host and port of the device.
    """

    def __init__(self, upstream: tuple[str, int]) -> None:
        super().__init__()
        self.upstream = upstream
        self.accepted = 0
        self.deaf = False
        self.idle_s = 0.0
        self._address: tuple[str, int] = ("127.0.0.1", 0)
        self._server: asyncio.Server | None = None
        self._lines: dict[_Line, asyncio.StreamWriter] = {}
        self._served: set[asyncio.Task[None]] = set()

    async def open(self, host: str = "127.0.0.1", port: int = 0) -> int:
        """Listen; returns the port."""
        self._server = await asyncio.start_server(self._serve, host, port)
        self._address = self._server.sockets[0].getsockname()[:2]
        return self._address[1]

    async def act(self, what: str) -> None:
        """Do something to every connection, or to the door, at once.

        `reset`, `close`, `half_open`: the connections. `refuse`: nobody listens any more. `deaf`: half open, and
        newcomers too. `heal`: everything is as it was at first, connections that were spoilt are ended.
        """
        self.note(what)
        if what in ("refuse", "restore") and self._server is not None:
            self._server.close()
            self._server = None
        if what == "restore":
            self.deaf = False
            for line in [line for line in self._lines if line.dead]:
                _end(self._lines[line], "reset")
            await self.open(*self._address)
        elif what == "deaf":
            self.deaf = True
            for line in self._lines:
                line.act("half_open")
        else:
            for line in list(self._lines):
                line.act("reset" if what == "refuse" else what)

    async def close(self) -> None:
        """Stop listening and hang up."""
        if self._server is not None:
            self._server.close()
        for task in self._served:
            task.cancel()
        await asyncio.gather(*self._served, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.accepted += 1
        task = asyncio.current_task()
        assert task is not None
        self._served.add(task)
        task.add_done_callback(self._served.discard)
        writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            from_device, to_device = await asyncio.open_connection(*self.upstream)
        except OSError:
            writer.transport.abort()
            return
        ends: dict[str, asyncio.StreamWriter] = {"request": to_device, "reply": writer}
        line = _Line(lambda data, way: ends[way].write(data), lambda what: _end(writer, what))
        line.dead = self.deaf
        self._lines[line] = writer
        pumps = [
            asyncio.ensure_future(self._pump(reader, "request", line)),
            asyncio.ensure_future(self._pump(from_device, "reply", line)),
        ]
        try:
            await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:  # the proxy is being closed
            pass
        finally:
            self._lines.pop(line, None)
            for pump in pumps:
                pump.cancel()
            for end in ends.values():
                end.transport.abort() if line.dead else end.close()
            await asyncio.gather(*pumps, return_exceptions=True)

    async def _pump(self, reader: asyncio.StreamReader, way: Way, line: _Line) -> None:
        """Pass frames of one way; what is no frame passes as it comes."""
        waiting = b""
        with contextlib.suppress(OSError):
            while data := await self._read(reader, way, line):
                waiting += data
                while len(waiting) >= 6 and len(waiting) >= (size := 6 + struct.unpack_from(">H", waiting, 4)[0]):
                    frame, waiting = waiting[:size], waiting[size:]
                    await self.carry(frame, way, line)
            if line.dead:
                await asyncio.Event().wait()  # neither side is told of the other's end

    async def _read(self, reader: asyncio.StreamReader, way: Way, line: _Line) -> bytes:
        """What comes next; a client that is silent for `idle_s` is hung up on."""
        if way == "reply" or self.idle_s == 0.0:
            return await reader.read(READ_BYTES)
        try:
            async with asyncio.timeout(self.idle_s):
                return await reader.read(READ_BYTES)
        except TimeoutError:
            self.note("idle")
            line.act("close")
            return b""


def _end(writer: asyncio.StreamWriter, what: str) -> None:
    """Close a connection, with a reset or without."""
    if what == "reset":
        connection = writer.get_extra_info("socket")
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()
    else:
        writer.close()


class PtyProxy(_Wire):
    """A pseudo-terminal for the daemon, tied to the one of the device; a read is a frame.

    Parameters
    ----------
    device
        Path of the device's own.
    link
        Symbolic link to what the daemon opens, as udev makes them by serial number.
    """

    framing = "rtu"

    def __init__(self, device: str, link: Path) -> None:
        super().__init__()
        self.link = link
        self._device = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._master = self._slave = -1
        self._pumps: set[asyncio.Task[None]] = set()
        self._line = _Line(self._send, lambda _: None)
        self._queues: dict[str, asyncio.Queue[bytes]] = {"request": asyncio.Queue(), "reply": asyncio.Queue()}

    async def open(self) -> None:
        """Plug in."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._device, self._read, self._device, "reply")
        for way in ("request", "reply"):
            self._pumps.add(loop.create_task(self._pump(way)))
        self._plug()

    async def act(self, what: str) -> None:
        """`unplug`; `plug`: as another terminal behind the same link."""
        self.note(what)
        if what == "unplug":
            self._unplug()
        elif what in ("plug", "restore"):
            self._line.dead = False
            if self._master < 0:
                self._plug()
        elif what in ("deaf", "half_open"):
            self._line.dead = True

    async def close(self) -> None:
        """Unplug for good."""
        self._unplug()
        asyncio.get_running_loop().remove_reader(self._device)
        os.close(self._device)
        for pump in self._pumps:
            pump.cancel()
        await asyncio.gather(*self._pumps, return_exceptions=True)

    def _plug(self) -> None:
        self._master, self._slave = os.openpty()  # our own end of it stays open: a cable is no hang-up
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._slave))
        asyncio.get_running_loop().add_reader(self._master, self._read, self._master, "request")

    def _unplug(self) -> None:
        if self._master < 0:
            return
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        self.link.unlink(missing_ok=True)
        self._master = self._slave = -1

    def _read(self, descriptor: int, way: Way) -> None:
        with contextlib.suppress(OSError):
            self._queues[way].put_nowait(os.read(descriptor, READ_BYTES))

    async def _pump(self, way: Way) -> None:
        while True:
            await self.carry(await self._queues[way].get(), way, self._line)

    def _send(self, data: bytes, way: Way) -> None:
        descriptor = self._device if way == "request" else self._master
        with contextlib.suppress(OSError):  # unplugged, or nobody reads: a serial line loses bytes
            os.write(descriptor, data)
