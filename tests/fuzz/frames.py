"""Fuzzing of device replies: the three wires with scripted system calls.

An input is one dialogue::

    [ how ][ split ][ bytes of the first reply | bytes of the second ]
       1       1       split                      the rest

`how` selects the link, its request, the pieces of the stream, and whether the device closes the connection. It also
selects whether lengths and checksums are corrected; otherwise few inputs would pass them. A second reader of the
standards checks what a link accepts (MODBUS Messaging on TCP/IP 1.0b, Serial Line 1.02, Application Protocol 1.1b3).
"""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Any

from piezod.config.link import ModbusRtuLink, ModbusTcpLink, SerialLineLink
from piezod.errors import PiezodError
from piezod.transport import ExchangeResult, Link
from piezod.transport.modbus import ModbusLink
from piezod.transport.modbus_rtu import RtuWire
from piezod.transport.modbus_tcp import TcpWire
from piezod.transport.serial_line import SerialLineDevice
from piezod.transport.serial_port import SerialPort
from tests.fuzz.target import Check, Target
from tests.unit.transport.scripted import LINE, SET_UP, crc, registers

OK = ExchangeResult.OK
VARIANT, POLL, SET_UP_READ, REPAIR, ENDS = 0b11, 1 << 2, 1 << 3, 1 << 4, 1 << 5
PIECES = (4096, 1, 3, 7)
UNIT, TRANSACTION, SEQUENCE, HEARTBEAT = 1, 0x0102, 42, 5
VOLTAGE_V = 20.0
PATIENCE_S = 10.0  # nothing waits for it, except that a link stops sending after a standstill of the process

Values = tuple[float, ...]


@dataclass(frozen=True)
class Map:
    """A register map, and the layout of its register block.

    Parameters
    ----------
    registers
        Registers section of the configuration.
    code
        `struct` format of the block: force, read-back, heartbeat, echo.
    unscrambled
        Function that puts the bytes of the block into that order.
    write_function, read_function
        Modbus functions; 23 for both: one exchange.
    scale
        Scale of force and read-back.
    written
        Bytes of the written voltage.
    """

    registers: dict[str, Any]
    code: str
    unscrambled: Callable[[bytes], bytes]
    write_function: int
    read_function: int
    scale: float
    written: bytes

    @property
    def size(self) -> int:
        """Size of the block [byte]."""
        return struct.calcsize(self.code)


def _integers() -> dict[str, Any]:
    """An integer map as of an analog I/O station, with the low byte of the force first."""
    return {
        "voltage_setpoint": {"address": 100, "function": 6, "type": "int16", "scale": 0.01, "unit": "V"},
        "force": {
            "address": 200,
            "function": 4,
            "type": "int16",
            "scale": 0.01,
            "order": "BA",
            "unit": "N",
            "high": 300,
        },
        "voltage_readback": {"address": 201, "function": 4, "type": "int16", "scale": 0.01, "unit": "V"},
        "heartbeat": {"address": 202, "function": 4, "type": "uint16"},
    } | SET_UP


MAPS = (
    Map(registers(), ">ffHHH", bytes, 23, 23, 1.0, struct.pack(">fH", VOLTAGE_V, SEQUENCE)),
    Map(registers(write=16, read=3), ">ffHHH", bytes, 16, 3, 1.0, struct.pack(">fH", VOLTAGE_V, SEQUENCE)),
    Map(_integers(), ">hhH", lambda raw: raw[1::-1] + raw[2:], 6, 4, 0.01, struct.pack(">h", 2000)),
)


class Script:
    """The scripted device: sends the next part after each request, in pieces."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.waiting = b""
        self.piece = PIECES[0]
        self.ends = False

    def load(self, parts: list[bytes], piece: int, *, ends: bool) -> None:
        """Start a dialogue."""
        self.parts, self.waiting, self.piece, self.ends = parts, b"", piece, ends

    def request(self) -> None:
        """Receive a request."""
        if self.parts:
            self.waiting += self.parts.pop(0)

    def gives(self) -> bool:
        """Whether bytes or the end of the stream can be read."""
        return bool(self.waiting) or (self.ends and not self.parts)

    def give(self, space: memoryview) -> int:
        """Copy the next piece; returns 0 at the end."""
        count = min(len(space), self.piece, len(self.waiting))
        space[:count] = self.waiting[:count]
        self.waiting = self.waiting[count:]
        return count


class ScriptedConnection:
    """Replacement of a socket and its poll object."""

    def __init__(self, script: Script) -> None:
        self.script = script

    def send(self, frame: bytes | bytearray) -> int:
        self.script.request()
        return len(frame)

    def recv_into(self, space: memoryview) -> int:
        return self.script.give(space)

    def poll(self, _timeout_ms: float) -> bool:
        return self.script.gives()

    def close(self) -> None:
        pass


class ScriptedPort(SerialPort):
    """A serial port without a descriptor."""

    __slots__ = ("script",)

    def __init__(self, config: ModbusRtuLink | SerialLineLink, script: Script) -> None:
        super().__init__(config)
        self.script = script

    def ensure_open(self, deadline_s: float = 0.0) -> ExchangeResult:
        return OK

    def wait(self, deadline_s: float) -> bool:
        return self.script.gives()

    def receive(self, at: int) -> int:
        count = self.script.give(self.view[at:])
        if count == 0:
            raise ConnectionError
        return count

    def drain(self) -> None:
        while self.script.waiting:
            self.stale_bytes += self.receive(0)

    def send(self, frame: bytearray | bytes, deadline_s: float) -> None:
        self.script.request()

    def close_and_settle(self, settle_s: float) -> None:
        pass

    def close_lost(self) -> None:
        pass


@dataclass(frozen=True)
class Request:
    """One request: its function, and its good reply (echoed bytes, number of bytes read)."""

    function: int
    echo: bytes
    bytes_read: int

    def payload(self, pdu: bytes) -> bytes | None:
        """The register bytes of a good reply; None for any other reply."""
        head = bytes((self.function, self.bytes_read)) if self.bytes_read else bytes((self.function,)) + self.echo
        good = pdu.startswith(head) and len(pdu) == len(head) + self.bytes_read
        return pdu[len(head) :] if good else None


class Dialogue:
    """One Modbus link with the same state before every case, and the expected results by the standard."""

    def __init__(self, block: Map, framing: str) -> None:
        self.map, self.framing, self.script = block, framing, Script()
        self.wire = self._tcp() if framing == "tcp" else self._rtu()
        self.link = ModbusLink(self.wire._config, self.wire)
        words = len(block.written) // 2
        wrote = b"\0\x64" + (struct.pack(">H", words) if block.write_function == 16 else block.written)
        read = Request(block.read_function, b"", block.size)
        self.exchanged = [read] if block.write_function == 23 else [Request(block.write_function, wrote, 0), read]
        self.polled = [Request(4 if block.read_function == 4 else 3, b"", block.size)]
        self.set_up = [Request(3, b"", 2)]

    def _tcp(self) -> TcpWire:
        where = {"kind": "modbus_tcp", "host": "127.0.0.1", "timeout_s": PATIENCE_S}
        return TcpWire(ModbusTcpLink.model_validate(where | {"registers": self.map.registers}))

    def _rtu(self) -> RtuWire:
        where = {"kind": "modbus_rtu", "port": "none", "baudrate": 12_000_000, "timeout_s": PATIENCE_S}
        config = ModbusRtuLink.model_validate(where | {"registers": self.map.registers})
        wire = RtuWire(config)
        wire._port = ScriptedPort(config, self.script)
        wire.payload = wire._port.view
        return wire

    def asked(self, how: int) -> list[Request]:
        """The requests of a dialogue."""
        return self.set_up if how & SET_UP_READ else self.polled if how & POLL else self.exchanged

    def hold(self, how: int, parts: list[bytes]) -> None:
        """Run the dialogue and compare the accepted replies with the standard."""
        self._begin(how, parts)
        expected = self._expected(how, parts)
        if how & SET_UP_READ:
            self._look_up(expected)
            return
        found = self.link.poll() if how & POLL else self.link.exchange(VOLTAGE_V)
        check_reading(self.link, found, expected)

    def good(self, how: int) -> list[bytes]:
        """Good replies."""
        asked = self.asked(how)
        payload = (7).to_bytes(2, "big") if how & SET_UP_READ else self._block()
        pdus = [
            bytes((one.function, one.bytes_read)) + payload if one.bytes_read else bytes((one.function,)) + one.echo
            for one in asked
        ]
        return [self.framed(pdu, k) for k, pdu in enumerate(pdus)]

    def framed(self, pdu: bytes, number: int) -> bytes:
        """A protocol data unit as reply to the request of that number."""
        if self.framing == "rtu":
            return crc(bytes((UNIT,)) + pdu)
        return struct.pack(">HHHB", TRANSACTION + number, 0, len(pdu) + 1, UNIT) + pdu

    def repaired(self, part: bytes, number: int) -> bytes:
        """The part with corrected transaction id, length and checksum."""
        if self.framing == "rtu":
            return crc(part[:-2])
        return struct.pack(">HHH", TRANSACTION + number, 0, max(0, len(part) - 6) % 65536) + part[6:]

    def _begin(self, how: int, parts: list[bytes]) -> None:
        """Set the state after connection and one good exchange."""
        self.script.load(list(parts), PIECES[how >> 6], ends=bool(how & ENDS))
        if isinstance(self.wire, TcpWire):
            self.wire._socket = self.wire._waiter = ScriptedConnection(self.script)
            self.wire._transaction = TRANSACTION - 1
        if self.link._set_point.has_sequence:
            self.link._set_point.sequence = SEQUENCE - 1
        self.link._plausibility._heartbeat, self.link._plausibility._heartbeat_known = HEARTBEAT, True
        self.link._written_generation = -1
        self.link._guard.mark_verified(self.wire.generation)

    def _block(self) -> bytes:
        """A valid register block."""
        if self.map.scale == 1.0:
            return struct.pack(">ffHHH", 41.5, VOLTAGE_V, HEARTBEAT + 1, SEQUENCE, 1)
        return struct.pack("<h", 4150) + struct.pack(">hH", 2000, HEARTBEAT + 1)

    def _expected(self, how: int, parts: list[bytes]) -> Values | None:
        """Force, read-back and heartbeat (or the one register of set-up); None when the reply must be refused."""
        payload: bytes | None = b""
        for k, one in enumerate(self.asked(how)):
            pdu = (rtu_pdu if self.framing == "rtu" else tcp_pdu)(parts[k] if k < len(parts) else b"", k, one)
            payload = None if pdu is None else one.payload(pdu)
            if payload is None:
                return None
        if how & SET_UP_READ:
            return (float(int.from_bytes(payload, "big")),)
        force, readback, heartbeat, *echo = struct.unpack(self.map.code, self.map.unscrambled(payload))
        force_N, readback_V = force * self.map.scale, readback * self.map.scale
        low, high = (-1000.0, 1000.0) if self.map.scale == 1.0 else (float("-inf"), 300.0)
        plausible = low <= force_N <= high and isfinite(readback_V) and advanced(heartbeat)
        answered = not echo or bool(how & POLL) or echo[0] == SEQUENCE
        return (force_N, readback_V, heartbeat) if plausible and answered else None

    def _look_up(self, expected: Values | None) -> None:
        try:
            found = self.link.read_register("watchdog_ms")
        except PiezodError:
            if expected is not None:
                raise AssertionError(f"{expected} was answered, and refused") from None
            raise
        if (found,) != expected:
            raise AssertionError(f"{found} was read, the standard says {expected or 'refuse'}")


class LineDialogue:
    """A line link; its device answers `GET` and `DOG`, and sends nothing after `SET`."""

    number = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
    reading = re.compile(rf"F=({number}) V=({number}) N=([0-9]+)")

    def __init__(self) -> None:
        self.script = Script()
        watchdog = {"send": "DOG {watchdog_ms:.0f}", "reply": r"DOG (?P<watchdog_ms>\S+)"}
        where = {"kind": "serial_line", "port": "none", "timeout_s": PATIENCE_S, "watchdog": watchdog}
        config = SerialLineLink.model_validate(LINE | where)
        self.link = SerialLineDevice(config)
        self.link._port = ScriptedPort(config, self.script)

    def hold(self, how: int, parts: list[bytes]) -> None:
        """Run the dialogue and compare the accepted replies with the line format."""
        self.link._set_up_generation = self.link._guard.verified = self.link._port.generation
        self.script.load(list(parts), PIECES[how >> 6], ends=bool(how & ENDS))
        self.link._plausibility._heartbeat, self.link._plausibility._heartbeat_known = HEARTBEAT, True
        if how & SET_UP_READ:
            self.link.write_register("watchdog_ms", 100.0)
            self.link.read_register("watchdog_ms")
            return
        found = self.link.poll() if how & POLL else self.link.exchange(VOLTAGE_V)
        part = parts[0] if how & POLL else parts[1] if len(parts) > 1 else b""
        check_reading(self.link, found, self._expected(part))

    def good(self, how: int) -> list[bytes]:
        """Good replies."""
        answer = f"F=41.5000 V={VOLTAGE_V:.4f} N={HEARTBEAT + 1}\n".encode()
        return [b"DOG 100\n"] if how & SET_UP_READ else [answer] if how & POLL else [b"", answer]

    def asked(self, how: int) -> list[bytes]:
        """One reply for each request."""
        return self.good(how)

    def repaired(self, part: bytes, number: int) -> bytes:
        """The part with a line end."""
        return part + b"\n"

    def _expected(self, part: bytes) -> Values | None:
        line, end, _ = part[:1024].partition(b"\n")
        found = self.reading.fullmatch(line.decode("latin-1")) if end else None
        if found is None:
            return None
        force_N, readback_V, heartbeat = float(found[1]), float(found[2]), int(found[3])
        good = isfinite(force_N) and isfinite(readback_V) and advanced(heartbeat)
        return (force_N, readback_V, heartbeat) if good else None


def tcp_pdu(stream: bytes, number: int, _asked: Request) -> bytes | None:
    """Data unit of the first frame with our transaction id; None after an invalid or incomplete frame."""
    at = 0
    while len(stream) - at >= 7:
        transaction, protocol, length, unit = struct.unpack_from(">HHHB", stream, at)
        if protocol != 0 or not 3 <= length <= 254 or len(stream) - at < 6 + length:
            return None
        if transaction == TRANSACTION + number:
            return stream[at + 7 : at + 6 + length] if unit == UNIT else None
        at += 6 + length
    return None


def rtu_pdu(stream: bytes, _number: int, asked: Request) -> bytes | None:
    """Data unit of the reply at the start of the stream; None for a wrong length, unit or checksum."""
    size = (5 + asked.bytes_read) if asked.bytes_read else 8
    frame = stream[:size]
    good = len(frame) == size and frame[0] == UNIT and crc(frame[:-2]) == frame
    return frame[1:-2] if good else None


def advanced(heartbeat: int) -> bool:
    """Whether the 16-bit counter has advanced."""
    return 0 < (heartbeat - HEARTBEAT) % 65536 < 32768


def check_reading(link: Link, found: ExchangeResult, expected: Values | None) -> None:
    """Compare result and reading with the standard."""
    if (found is OK) != (expected is not None):
        raise AssertionError(f"the link says {found.name}, the standard says {expected or 'refuse'}")
    reading = link.reading
    if expected is not None and (reading.force_N, reading.voltage_readback_V, reading.heartbeat) != expected:
        raise AssertionError(f"{reading.force_N}, {reading.voltage_readback_V} were read, the standard says {expected}")


def dialogue_of(data: bytes, dialogues: list[Any]) -> tuple[Any, int, list[bytes]]:
    """Link, request and replies that an input encodes."""
    how, split = data[0], data[1]
    dialogue, body = dialogues[how % (VARIANT + 1) % len(dialogues)], data[2:]
    parts = [body[:split], body[split:]] if len(dialogue.asked(how)) > 1 else [body]
    if how & REPAIR:
        parts = [dialogue.repaired(part, k) for k, part in enumerate(parts)]
    return dialogue, how, parts


def check_with(dialogues: list[Any]) -> Check:
    """Run a dialogue, then a good one, which must succeed."""

    def check(data: bytes) -> None:
        if len(data) < 2:
            return
        dialogue, how, parts = dialogue_of(data, dialogues)
        try:
            dialogue.hold(how, parts)
        finally:
            healthy = how & VARIANT
            dialogue.hold(healthy, dialogue.good(healthy))

    return check


def seeds_of(dialogues: list[Any]) -> list[bytes]:
    """Good dialogues of every link and request, an exception, and a reply to another client first."""
    seeds = []
    for variant, dialogue in enumerate(dialogues):
        for how in (variant, variant | POLL, variant | SET_UP_READ, variant | REPAIR, variant | ENDS, variant | 1 << 6):
            parts = dialogue.good(how)
            bodies = [parts]
            if isinstance(dialogue, Dialogue):
                bodies.append([dialogue.framed(bytes((dialogue.asked(how)[0].function | 0x80, 4)), 0)])
                bodies.append([dialogue.framed(b"\x03\x02\0\0", 99) + parts[0], *parts[1:]])
            seeds += [bytes((how, len(body[0]))) + b"".join(body) for body in bodies]
    return seeds


def _modbus(framing: str) -> list[Dialogue]:
    return [Dialogue(block, framing) for block in MAPS]


TARGETS = [
    Target("modbus_tcp", "frames", lambda: seeds_of(_modbus("tcp")), lambda: check_with(_modbus("tcp"))),
    Target("modbus_rtu", "frames", lambda: seeds_of(_modbus("rtu")), lambda: check_with(_modbus("rtu"))),
    Target("serial_line", "frames", lambda: seeds_of([LineDialogue()]), lambda: check_with([LineDialogue()])),
]
