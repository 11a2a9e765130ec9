"""A proxy with injectable faults between daemon and device, over TCP or between two pseudo-terminals.

    daemon  <->  proxy  <->  device

The proxy forwards whole frames. Rules change some of them; `act` acts on the connections at once. `done` lists every
action.
"""

import asyncio
import contextlib
import os
import random
import socket
import struct
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tests.faults.forgeries import forged

Way = Literal["request", "reply"]
Send = Callable[[bytes, Way], None]
ACTIONS = (
    "duplicate",  # twice in one segment
    "split",  # into segments, eight of them of one byte; they begin one byte later in each frame
    "corrupt",  # invert one bit in the middle
    "forge",  # a false reply of `kind` instead
    "random",  # random bytes instead, at least as many
)
READ_BYTES = 4096
SINGLE_BYTES = 8  # segments of one byte in a split frame


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
    kind
        Kind of a false reply, one of `forgeries.KINDS`.
    """

    do: str
    way: Way = "reply"
    after: int = 0
    count: int = 1
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


class _Wire:
    """The part of a proxy that does not depend on the transport: rules and their application to frames."""

    framing = "tcp"

    def __init__(self) -> None:
        self.rules: list[Rule] = []
        self.done: list[str] = []
        self._before = b""
        self._forged = 0
        self._splits = 0
        self._random = random.Random(1)

    def schedule(self, rules: list[Rule]) -> None:
        """Replace the rules."""
        self.rules = rules

    async def carry(self, frame: bytes, way: Way, send: Send) -> None:
        """Forward a frame, or apply the first rule that takes it."""
        rule = self._rule(way)
        if way == "reply":
            before, self._before = self._before, frame
        else:
            before = b""
        if rule is None:
            send(frame, way)
            return
        self.done.append(rule.do)
        for part in self._changed(rule, frame, before):
            send(part, way)
            await asyncio.sleep(0)  # send each part in its own segment

    def _rule(self, way: Way) -> Rule | None:
        """The first rule that applies to the frame; all rules count the frame."""
        taken = [rule for rule in self.rules if rule.takes(way)]
        return taken[0] if taken else None

    def _changed(self, rule: Rule, frame: bytes, before: bytes) -> list[bytes]:
        """The segments sent instead of a frame."""
        if rule.do == "forge" and before:
            self._forged += 1
            return [forged(rule.kind, frame, before, self._forged - 1, framing=self.framing)]
        at = len(frame) // 2
        changes: dict[str, Callable[[], list[bytes]]] = {
            "duplicate": lambda: [frame + frame],
            "split": lambda: self._split(frame),
            "corrupt": lambda: [frame[:at] + bytes((frame[at] ^ 0x10,)) + frame[at + 1 :]],
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
        self._address: tuple[str, int] = ("127.0.0.1", 0)
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()
        self._served: set[asyncio.Task[None]] = set()

    async def open(self, host: str = "127.0.0.1", port: int = 0) -> int:
        """Listen; returns the port."""
        self._server = await asyncio.start_server(self._serve, host, port)
        self._address = self._server.sockets[0].getsockname()[:2]
        return self._address[1]

    async def act(self, what: str) -> None:
        """`refuse`: stop listening and reset the connections. `restore`: listen again."""
        self.done.append(what)
        if self._server is not None:
            self._server.close()
            self._server = None
        if what == "restore":
            await self.open(*self._address)
        else:
            for writer in list(self._writers):
                _reset(writer)

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
        self._writers.add(writer)
        pumps = [
            asyncio.ensure_future(self._pump(reader, "request", ends)),
            asyncio.ensure_future(self._pump(from_device, "reply", ends)),
        ]
        try:
            await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:  # the proxy is being closed
            pass
        finally:
            self._writers.discard(writer)
            for pump in pumps:
                pump.cancel()
            for end in ends.values():
                end.close()
            await asyncio.gather(*pumps, return_exceptions=True)

    async def _pump(self, reader: asyncio.StreamReader, way: Way, ends: dict[str, asyncio.StreamWriter]) -> None:
        """Forward the frames of one direction; the MBAP length delimits them."""
        waiting = b""
        with contextlib.suppress(OSError):
            while data := await reader.read(READ_BYTES):
                waiting += data
                while len(waiting) >= 6 and len(waiting) >= (size := 6 + struct.unpack_from(">H", waiting, 4)[0]):
                    frame, waiting = waiting[:size], waiting[size:]
                    await self.carry(frame, way, lambda data, way: ends[way].write(data))


def _reset(writer: asyncio.StreamWriter) -> None:
    """Reset a connection."""
    with contextlib.suppress(OSError):
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


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
        self._queues: dict[str, asyncio.Queue[bytes]] = {"request": asyncio.Queue(), "reply": asyncio.Queue()}

    async def open(self) -> None:
        """Connect both terminals."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._device, self._read, self._device, "reply")
        for way in ("request", "reply"):
            self._pumps.add(loop.create_task(self._pump(way)))
        self._plug()

    async def act(self, what: str) -> None:
        """`unplug` removes the terminal, `plug` and `restore` add a new one behind the same link."""
        self.done.append(what)
        if what == "unplug":
            self._unplug()
        elif self._master < 0:
            self._plug()

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
            await self.carry(await self._queues[way].get(), way, self._send)

    def _send(self, data: bytes, way: Way) -> None:
        descriptor = self._device if way == "request" else self._master
        with contextlib.suppress(OSError):  # unplugged or without a reader: the bytes are lost
            os.write(descriptor, data)
