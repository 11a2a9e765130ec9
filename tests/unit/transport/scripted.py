"""Devices with scripted answers, written from the Modbus specification without pymodbus or piezod."""

import contextlib
import os
import select
import socket
import struct
import threading
import time
import tty
from pathlib import Path

CLOSE, RESET = "close", "reset"  # actions in an answer, besides bytes to send and seconds to wait
FORCE_N_PER_V = 2.0

MAP = {
    "voltage_setpoint": {"address": 100, "unit": "V"},
    "command_sequence": {"address": 102, "type": "uint16"},
    "force": {"address": 200, "unit": "N", "low": -1000, "high": 1000},
    "voltage_readback": {"address": 202, "unit": "V"},
    "heartbeat": {"address": 204, "type": "uint16"},
    "command_echo": {"address": 205, "type": "uint16"},
    "status": {"address": 206, "type": "uint16"},
}
SET_UP = {
    "identity": {"address": 0, "function": 3, "type": "uint16", "expect": 20570},
    "order_check": {"address": 2, "function": 3, "type": "float32", "expect": 1234.5},
    "watchdog_ms": {"address": 110, "function": 16, "type": "uint16", "unit": "ms"},
}


def registers(write=23, read=23, without=(), **more):
    """The register map with the given functions, and without some roles."""
    roles = {role: dict(entry) for role, entry in MAP.items() if role not in without}
    for role, entry in roles.items():
        entry["function"] = write if role in ("voltage_setpoint", "command_sequence") else read
    return roles | SET_UP | more


def crc(data):
    """MODBUS over Serial Line 1.02, 6.2.2, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return data + struct.pack("<H", value)


class Bench:
    """Registers in memory; each request for the block advances the heartbeat."""

    def __init__(self):
        self.memory = bytearray(2 * 65536)
        self.heartbeat = 0
        self.requests = []
        self.put(0, ">H", 20570)
        self.put(2, ">f", 1234.5)

    def put(self, address, code, value):
        struct.pack_into(code, self.memory, 2 * address, value)

    def get(self, address, code):
        return struct.unpack_from(code, self.memory, 2 * address)[0]

    @property
    def voltage_V(self):
        return self.get(100, ">f")

    def sample(self):
        self.heartbeat = (self.heartbeat + 1) % 65536
        self.put(200, ">f", FORCE_N_PER_V * self.voltage_V)
        self.put(202, ">f", self.voltage_V)
        self.put(204, ">H", self.heartbeat)
        self.put(205, ">H", self.get(102, ">H"))

    def pdu(self, request):
        """Answer one protocol data unit."""
        self.requests.append(request)
        function = request[0]
        if function == 23:
            address, count, write_address, _, size = struct.unpack(">HHHHB", request[1:10])
            self.memory[2 * write_address : 2 * write_address + size] = request[10 : 10 + size]
            return self.read(function, address, count)
        address, count = struct.unpack(">HH", request[1:5])
        if function in (3, 4):
            return self.read(function, address, count)
        if function == 16:
            self.memory[2 * address : 2 * address + 2 * count] = request[6 : 6 + 2 * count]
            return request[:5]
        if function == 6:
            self.memory[2 * address : 2 * address + 2] = request[3:5]
            return request
        return bytes((function | 0x80, 1))

    def read(self, function, address, count):
        if address >= 200:
            self.sample()
        return bytes((function, 2 * count)) + bytes(self.memory[2 * address : 2 * address + 2 * count])


class _Scripted:
    """Calls `answer(frame, number)` for each request; it returns bytes to send, times to wait [s], or actions."""

    def __init__(self, bench=None):
        self.bench = bench or Bench()
        self.answer = lambda frame, _number: [self.good(frame)]
        self.number = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(5)
        self.release()

    def once(self, answer):
        """Answer the next request by `answer`, and the following ones correctly."""
        first = self.number

        def choose(frame, number):
            return answer(frame) if number == first else [self.good(frame)]

        self.answer = choose

    def _reply(self, frame, send):
        number, self.number = self.number, self.number + 1
        for part in self.answer(frame, number):
            if part in (CLOSE, RESET):
                return part
            if isinstance(part, float):
                self._stop.wait(part)
            else:
                send(part)
        return None


class ScriptedTcp(_Scripted):
    """Modbus TCP server for one client at a time."""

    def __init__(self, bench=None):
        super().__init__(bench)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.connections = 0

    def good(self, frame):
        reply = self.bench.pdu(frame[7:])
        return struct.pack(">HHHB", struct.unpack_from(">H", frame)[0], 0, len(reply) + 1, frame[6]) + reply

    def release(self):
        self.listener.close()

    def _serve(self):
        while not self._stop.is_set():
            if not select.select([self.listener], [], [], 0.02)[0]:
                continue
            connection, _ = self.listener.accept()
            self.connections += 1
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection, contextlib.suppress(OSError):
                self._serve_client(connection)

    def whole(self, waiting):
        """Length of the first request in `waiting`; 0: incomplete."""
        size = 6 + struct.unpack_from(">H", waiting, 4)[0] if len(waiting) >= 6 else 0
        return size if len(waiting) >= size else 0

    def _serve_client(self, connection):
        waiting = b""
        while not self._stop.is_set():
            if not select.select([connection], [], [], 0.02)[0]:
                continue
            data = connection.recv(4096)
            if not data:
                return
            waiting += data
            while size := self.whole(waiting):
                frame, waiting = waiting[:size], waiting[size:]
                done = self._reply(frame, connection.sendall)
                if done == RESET:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                if done:
                    return


class ScriptedPty(_Scripted):
    """Modbus RTU device on a pseudo-terminal; the port stays open without a client, like a cable."""

    def __init__(self, bench=None):
        super().__init__(bench)
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)

    def good(self, frame):
        return crc(frame[:1] + self.bench.pdu(frame[1:-2]))

    def release(self):
        for descriptor in (self.master, self.slave):
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def whole(self, waiting):
        """Length of the first request in `waiting`; 0: incomplete."""
        if len(waiting) < 8:
            return 0
        fixed = {23: (11, 10), 16: (7, 6)}.get(waiting[1])
        if fixed is None:
            return 8
        head, count_at = fixed
        size = head + waiting[count_at] + 2 if len(waiting) > count_at else 0
        return size if len(waiting) >= size else 0

    def _serve(self):
        waiting = b""
        while not self._stop.is_set():
            with contextlib.suppress(OSError):
                if not select.select([self.master], [], [], 0.02)[0]:
                    continue
                waiting += os.read(self.master, 4096)
                while size := self.whole(waiting):
                    frame, waiting = waiting[:size], waiting[size:]
                    if self._reply(frame, self._send):
                        return

    def _send(self, data):
        os.write(self.master, data)


class ScriptedGateway(ScriptedTcp):
    """A serial gateway: RTU frames over TCP, one client at a time; what a client has not read is lost with it."""

    good = ScriptedPty.good
    whole = ScriptedPty.whole


class ScriptedLine(ScriptedPty):
    """A device with the commands `SET 1.000`, `GET`, `ID` and `DOG 100`."""

    def good(self, frame):
        word, _, rest = frame.decode("ascii").strip().partition(" ")
        self.bench.requests.append(frame)
        if word == "SET":
            self.bench.put(100, ">f", float(rest))
            return b""
        if word == "GET":
            self.bench.sample()
            return f"F={self.bench.get(200, '>f'):.4f} V={self.bench.voltage_V:.4f} N={self.bench.heartbeat}\n".encode()
        return {"ID": b"bench 7\n", "DOG": f"DOG {rest}\n".encode()}.get(word, b"?\n")

    def whole(self, waiting):
        return waiting.find(b"\n") + 1


LINE = {
    "terminator": "\n",
    "setup": [{"send": "INIT", "reply": r"\?"}],
    "identity": {"send": "ID", "reply": "bench [0-9]"},
    "set_voltage": {"send": "SET {voltage_V:.3f}"},
    "measure": {
        "send": "GET",
        "reply": r"F=(?P<force_N>\S+) V=(?P<voltage_readback_V>\S+) N=(?P<heartbeat>\d+)",
    },
    "watchdog": {"send": "DOG {watchdog_ms:.0f}", "reply": r"DOG (?P<watchdog_ms>\d+)"},
}


def snapshot(reading):
    return {name: getattr(reading, name) for name in type(reading).__slots__}


def descriptors():
    """Number of open file descriptors of this process."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def until_good(act, seconds=2.0):
    """Repeat `act` until it returns OK (0); all its results."""
    results, end = [], time.monotonic() + seconds
    while not results or results[-1] != 0:
        assert time.monotonic() < end, results[-5:]
        results.append(act())
        if results[-1] != 0:
            time.sleep(0.002)
    return results
