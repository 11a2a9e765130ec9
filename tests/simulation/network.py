"""The network between service and device: bytes with delay, loss, doubling, splitting, garbling, cuts and resets."""

import asyncio
import errno

from pymodbus.pdu import ExceptionResponse

from firmware_sim.wire.tcp import ModbusTcpProtocol
from tests.faults.forgeries import forged

LEAST_DELAY_NS = 25_000
SPREAD_NS = 40_000
MS = 1_000_000


class RefusingUnit:
    """A Modbus unit that answers some requests with an exception."""

    def __init__(self, amplifier):
        self._amplifier = amplifier
        self.decoder = amplifier.unit.decoder
        self.only = (0, -1)  # function and address that are refused; 0 and -1: any

    def reply(self, frame, unit_id, transaction_id):
        code, count = self._amplifier.refusal
        function, address = self.only
        meant = function in (0, frame[0]) and address in (-1, int.from_bytes(frame[1:3], "big"))
        if count and meant:
            self._amplifier.refusal = (code, count - 1)
            answer = ExceptionResponse(frame[0], code)
            answer.dev_id, answer.transaction_id = unit_id, transaction_id
            return answer
        return self._amplifier.unit.reply(frame, unit_id, transaction_id)


class Far(asyncio.Transport):
    """The device's end of one connection."""

    def __init__(self, connection):
        super().__init__()
        self._connection = connection

    def write(self, data):
        self._connection.carry("reply", bytes(data))

    def abort(self):
        self._connection.reset()

    def close(self):
        self._connection.reset()


class TcpConnection:
    """One connection; bytes keep their order in each direction."""

    def __init__(self, network, stream):
        self.network, self.stream = network, stream
        self.machine = network.machine
        self.alive = True
        self.last_ns = {"request": 0, "reply": 0}
        self.protocol = ModbusTcpProtocol(network.unit, network.amplifier.settings, network.clients)
        stream.route = self.sent
        network.connections.append(self)
        network.connected += 1
        self.asked_ns = self.machine.now_ns
        self.protocol.connection_made(Far(self))

    def sent(self, data):
        """Bytes of the service; None: it has closed."""
        if data is None:
            self.alive = False
            self.network.drop(self)
            self.machine.after(LEAST_DELAY_NS, lambda: self.protocol.connection_lost(None))
            return
        self.carry("request", data)

    def carry(self, way, data):
        if not self.alive:
            return
        network = self.network
        for delay_ns, part in network.fate(way, data, self):
            at_ns = max(self.last_ns[way], self.machine.now_ns + delay_ns)
            self.last_ns[way] = at_ns
            self.machine.at(at_ns, lambda part=part: self.arrive(way, part))

    def arrive(self, way, data):
        if not self.alive or self.network.cut:
            return
        self.machine.digest.update(b"%d %s " % (self.machine.now_ns, way.encode()) + data)
        if way == "request":
            self.asked_ns = self.machine.now_ns
            self.network.name_sender(self.stream)
            self.protocol.data_received(data)
        else:
            self.stream.arrive(data)

    def reset(self):
        if self.alive:
            self.alive = False
            self.network.drop(self)
            self.protocol.connection_lost(None)
            self.machine.after(LEAST_DELAY_NS, self.stream.reset)


class Network:
    """The way to the device; `rules` hold what happens to the next frames."""

    framing = "tcp"

    def __init__(self, machine, amplifier):
        self.machine, self.amplifier = machine, amplifier
        self.unit = RefusingUnit(amplifier)
        self.clients, self.connections = set(), []
        self.rules = []  # [fault, way, count, size]
        self.cut = self.refuses = False
        self.random = machine.random
        self.frames = self.connected = self.forgeries = self.idle_ns = 0
        self.replies = b"", b""  # the last two good ones
        self.sees = lambda data, framing: None  # called with the bytes of the service
        self.held = {"request": b"", "reply": b""}  # frames that wait for the next one of their direction

    def connect(self, socket, stream):
        del socket
        stream.connecting = True

        def decide():
            if not stream.open or self.cut:
                return
            stream.connecting = False
            if self.refuses:
                stream.error = errno.ECONNREFUSED
            else:
                TcpConnection(self, stream)
            stream.changed()

        self.machine.after(2 * LEAST_DELAY_NS, decide)

    def name_sender(self, stream):
        """Tell the device which service sends; a control process belongs to its parent."""
        if stream.owners:
            process = stream.owners[0]
            self.amplifier.device.sender = (process.parent or process).pid

    def drop(self, connection):
        if connection in self.connections:
            self.connections.remove(connection)

    def reset(self):
        for connection in list(self.connections):
            connection.reset()

    def fate(self, way, data, connection):
        """Delays [ns] and parts in which `data` arrives."""
        self.frames += 1
        if way == "request":
            self.sees(data, self.framing)
        if way == "reply":
            self.replies = self.replies[1], data
        delay_ns = LEAST_DELAY_NS + int(self.random.random() ** 3 * SPREAD_NS)
        for rule in self.rules:
            fault, direction, count, size = rule
            if direction != way or count <= 0:
                continue
            rule[2] -= 1
            if not rule[2]:
                self.rules.remove(rule)
            self.machine.note("wire", fault, way)
            return self.struck(fault, way, data, delay_ns, size, connection)
        return [(delay_ns, data)]

    def struck(self, fault, way, data, delay_ns, size_ms, connection):
        """Delays and parts of bytes that a fault has met.

        `size_ms` is a delay [ms], for `throttle` the time for each byte [ns], for `forge` the kind of the false reply.
        """
        rng = self.random
        at = 1 + int(rng.random() * (len(data) - 1))
        garbled = data[: at - 1] + bytes([data[at - 1] ^ 1 << int(8 * rng.random())]) + data[at:]
        later_ns = 0 if fault in ("throttle", "forge") else int(size_ms * MS)
        if fault == "reset":
            self.machine.after(0, connection.reset)
        elif fault == "echo":
            connection.carry("reply", data)
        elif fault == "lag":
            self.held[way], data = data, self.held[way]
        return {
            "drop": [],
            "reset": [],
            "delay": [(delay_ns + later_ns, data)],
            "split": [(delay_ns, data[:at]), (delay_ns + later_ns, data[at:])],
            "duplicate": [(delay_ns, data), (delay_ns, data)],
            "corrupt": [(delay_ns, garbled)],
            "garbage": [(delay_ns, rng.randbytes(len(data)))],
            "noise": [(delay_ns, rng.randbytes(7) + data)],
            "noise_around": [(delay_ns, rng.randbytes(3) + data + rng.randbytes(2))],
            "echo": [(delay_ns, data)],
            "lag": [(delay_ns, data)] if data else [],
            "throttle": [(delay_ns + int(size_ms * len(data)) if fault == "throttle" else 0, data)],
            "forge": [(delay_ns, self._forged(size_ms, data) if fault == "forge" else data)],
        }[fault]

    def _forged(self, kind, data):
        before, number = self.replies[0], self.forgeries
        self.forgeries += 1
        return forged(kind, data, before or data, number, framing=self.framing)
