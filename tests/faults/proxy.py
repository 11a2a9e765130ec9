"""A proxy with injectable faults between daemon and device, over TCP or between two pseudo-terminals.

    daemon  <->  proxy  <->  device

The proxy forwards whole frames. Rules change some of them; `act` acts on the connections at once. `done` lists every
action with its time.
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
    "delay",  # forward it `by` seconds later; later frames wait too
    "drop",
    "duplicate",  # twice in one segment
    "split",  # into segments, eight of them of one byte; they begin one byte later in each frame
    "corrupt",  # invert one bit in the middle
    "reset",  # reset the connection instead of forwarding the frame
    "close",
    "half_open",  # forward nothing from now on, without closing the connection
    "stall",  # hold all frames of both directions for `by` seconds
    "lag",  # hold each frame until the next one of its direction
    "forge",  # a false reply of `kind` instead
    "noise",  # three bytes before the frame, two after it
    "echo",  # send a request back to its sender, before the reply
    "throttle",  # `by` bytes a second
    "random",  # random bytes instead, at least as many
)
NOISE = (b"\x55\x00\xff", b"\xaa\x7e")
READ_BYTES = 4096
SINGLE_BYTES = 8  # segments of one byte in a split frame
ROUNDED_S = 0.0015


@dataclass
class Rule:
    """An action on some frames.

    Parameters
    ----------
    do
        One of `ACTIONS`.
    way
        Direction of the frames: `request` or `reply`.
    after
        Number of frames that are forwarded unchanged first.
    count
        Number of frames to act on; 0: all later ones.
    by
        Duration [s], or rate of `throttle` [byte/s].
    kind
        Kind of a false reply, one of `forgeries.KINDS`.
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
        """Count a frame and return whether the rule applies to it."""
        if way != self.way:
            return False
        self._seen += 1
        behind = self._seen - self.after
        return behind > 0 and (self.count == 0 or behind <= self.count)


@dataclass(frozen=True)
class ProxyAction:
    """An executed action: time [ns, monotonic], name, direction and frame (hexadecimal)."""

    time_ns: int
    do: str
    way: str
    frame: str


class _Wire:
    """The part of a proxy that does not depend on the transport: rules and their application to frames."""

    framing = "tcp"

    def __init__(self) -> None:
        self.rules: list[Rule] = []
        self.done: list[ProxyAction] = []
        self.passed = 0
        self.late_s = 0.0  # largest excess over a requested delay
        self._before = b""
        self._forged = 0
        self._splits = 0
        self._random = random.Random(1)
        self._flowing = asyncio.Event()
        self._flowing.set()

    def schedule(self, rules: list[Rule]) -> None:
        """Replace the rules and end a stall."""
        self.rules = rules
        self._flowing.set()

    def note(self, do: str, way: str = "", frame: bytes = b"") -> None:
        """Add an action to `done`."""
        self.done.append(ProxyAction(time.monotonic_ns(), do, way, frame.hex()))

    def stall(self, duration_s: float) -> None:
        """Hold all frames for `duration_s`."""
        self.note("stall")
        self._flowing.clear()
        asyncio.get_running_loop().call_later(duration_s, self._flowing.set)

    async def carry(self, frame: bytes, way: Way, line: "_Line") -> None:
        """Forward a frame, or apply the first rule that takes it."""
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
        """The first rule that applies to the frame; all rules count the frame."""
        taken = [rule for rule in self.rules if rule.takes(way)]
        return taken[0] if taken else None

    async def _do(self, rule: Rule, frame: bytes, before: bytes, way: Way, line: "_Line") -> None:
        """Apply a rule; `_changed` makes the bytes of rules that change the frame."""
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
                    await asyncio.sleep(0)  # send each part in its own segment

    def _changed(self, rule: Rule, frame: bytes, before: bytes) -> list[bytes]:
        """The segments sent instead of a frame."""
        if rule.do == "forge" and before:
            self._forged += 1
            return [forged(rule.kind, frame, before, self._forged - 1, framing=self.framing)]
        at = len(frame) // 2
        changes: dict[str, Callable[[], list[bytes]]] = {
            "drop": list,
            "duplicate": lambda: [frame + frame],
            "split": lambda: self._split(frame),
            "corrupt": lambda: [frame[:at] + bytes((frame[at] ^ 0x10,)) + frame[at + 1 :]],
            "noise": lambda: [NOISE[0] + frame + NOISE[1]],
            "random": lambda: [self._random.randbytes(len(frame) + self._random.randrange(40))],
        }
        return changes.get(rule.do, lambda: [frame])()

    def _split(self, frame: bytes) -> list[bytes]:
        """Segments of the frame, never empty. Every byte of it is a segment in some frames.

        A segment costs about 40 us in each process, and all of them must arrive within a tick.
        """
        begin = self._splits % len(frame)
        self._splits += 1
        end = begin + SINGLE_BYTES
        segments = [frame[:begin], *(frame[k : k + 1] for k in range(begin, min(end, len(frame)))), frame[end:]]
        return [segment for segment in segments if segment]


async def _pause(duration_s: float) -> float:
    """Wait; returns the excess over `duration_s` [s].

    asyncio alone rounds up to whole milliseconds, a large part of a tick; so the last part polls the clock.
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
        """Send data in the given direction unless the line is half open."""
        if data and not self.dead:
            self._send(data, way)

    def act(self, what: str) -> None:
        """Reset or close the connection, or (`half_open`) stop forwarding."""
        if what == "half_open":
            self.dead = True
        else:
            self._act(what)


class TcpProxy(_Wire):
    """A proxy that listens for the daemon and connects to the device over TCP.

    Parameters
    ----------
    upstream
        Host and port of the device.
    """

    def __init__(self, upstream: tuple[str, int]) -> None:
        super().__init__()
        self.upstream = upstream
        self.accepted = 0
        self.silent = False
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
        """Act on every connection, or on the listening socket, at once.

        `reset`, `close`, `half_open`: act on the connections. `refuse`: stop listening and reset the connections.
        `silent`: half open, for present and new connections. `restore`: listen and forward again; half-open
        connections are reset.
        """
        self.note(what)
        if what in ("refuse", "restore") and self._server is not None:
            self._server.close()
            self._server = None
        if what == "restore":
            self.silent = False
            for line in [line for line in self._lines if line.dead]:
                _end(self._lines[line], "reset")
            await self.open(*self._address)
        elif what == "silent":
            self.silent = True
            for line in self._lines:
                line.act("half_open")
        else:
            for line in list(self._lines):
                line.act("reset" if what == "refuse" else what)

    async def close(self) -> None:
        """Stop listening and close the connections."""
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
        line.dead = self.silent
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
        """Forward the frames of one direction; the MBAP length delimits them."""
        waiting = b""
        with contextlib.suppress(OSError):
            while data := await self._read(reader, way, line):
                waiting += data
                while len(waiting) >= 6 and len(waiting) >= (size := 6 + struct.unpack_from(">H", waiting, 4)[0]):
                    frame, waiting = waiting[:size], waiting[size:]
                    await self.carry(frame, way, line)
            if line.dead:
                await asyncio.Event().wait()  # a half-open connection does not report the end of the other side

    async def _read(self, reader: asyncio.StreamReader, way: Way, line: _Line) -> bytes:
        """Read the next bytes; closes the connection of a client that is silent for `idle_s`."""
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
    """Close a connection; `what` is `reset` or `close`."""
    if what == "reset":
        connection = writer.get_extra_info("socket")
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()
    else:
        writer.close()


class PtyProxy(_Wire):
    """A proxy between a pseudo-terminal for the daemon and that of the device; each read is a frame.

    Parameters
    ----------
    device
        Path of the terminal of the device.
    link
        Symbolic link that the daemon opens, like those of udev by serial number.
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
        """Connect both terminals."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._device, self._read, self._device, "reply")
        for way in ("request", "reply"):
            self._pumps.add(loop.create_task(self._pump(way)))
        self._plug()

    async def act(self, what: str) -> None:
        """`unplug` removes the terminal, `plug` adds a new one behind the same link, `silent` stops forwarding."""
        self.note(what)
        if what == "unplug":
            self._unplug()
        elif what in ("plug", "restore"):
            self._line.dead = False
            if self._master < 0:
                self._plug()
        elif what in ("silent", "half_open"):
            self._line.dead = True

    async def close(self) -> None:
        """Remove the terminal and stop forwarding."""
        self._unplug()
        asyncio.get_running_loop().remove_reader(self._device)
        os.close(self._device)
        for pump in self._pumps:
            pump.cancel()
        await asyncio.gather(*self._pumps, return_exceptions=True)

    def _plug(self) -> None:
        self._master, self._slave = os.openpty()  # this end stays open, so that no hang-up is reported
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
        with contextlib.suppress(OSError):  # unplugged or without a reader: the bytes are lost
            os.write(descriptor, data)
