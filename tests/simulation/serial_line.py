"""A serial line between service and device: Modbus RTU without numbered replies, an adapter that can be unplugged."""

import errno

import serial

from firmware_sim.wire.rtu import RtuStation
from tests.simulation.network import Network
from tests.simulation.sockets import Stream

UNIT_ID = 1
BAUDRATE = 921_600
BITS_PER_CHARACTER = 11
NS_PER_BYTE = round(1e9 * BITS_PER_CHARACTER / BAUDRATE)


class OpenPort:
    """As `serial.Serial`, for the port of the history.

    Parameters
    ----------
    network
        The line.
    port
        Path of the port.

    Raises
    ------
    serial.SerialException
        The adapter is unplugged, or another process has locked the port.
    """

    def __init__(self, network, port, *_, **__):
        if network.refuses or port != str(network.path):
            raise serial.SerialException(errno.ENOENT, f"could not open port {port}")
        if network.held_by_other or any(one.alive for one in network.connections):
            raise serial.SerialException(errno.EAGAIN, "could not exclusively lock port")
        self._stream = Stream(network.kernel, network.machine.process)
        SerialConnection(network, self._stream)

    def fileno(self):
        return self._stream.descriptor

    def close(self):
        self._stream.closed_by(self._stream.machine.process)

    def set_low_latency_mode(self, _):
        raise ValueError("not this driver")


class SerialConnection:
    """The bytes of one opening of the port; bytes keep their order in each direction."""

    def __init__(self, network, stream):
        self.network, self.stream, self.machine = network, stream, network.machine
        self.alive, self.unplugged = True, False
        self.last_ns = {"request": 0, "reply": 0}
        stream.route = self.sent
        network.connections.append(self)
        network.connected += 1
        self.asked_ns = self.machine.now_ns

    def sent(self, data):
        """Bytes of the service; None: it has closed."""
        if data is None:
            self.alive = False
            self.network.drop(self)
            return
        self.carry("request", data)

    def carry(self, way, data):
        if not self.alive:
            return
        for delay_ns, part in self.network.fate(way, data, self):
            duration_ns = len(part) * NS_PER_BYTE
            at_ns = max(self.last_ns[way], self.machine.now_ns + delay_ns) + duration_ns
            self.last_ns[way] = at_ns
            self.machine.at(at_ns, lambda part=part: self.arrive(way, part))

    def arrive(self, way, data):
        """Bytes at their end of the line; the station stays when the service has opened the port anew."""
        network = self.network
        if network.cut or network.refuses or self.unplugged:
            return  # what is on its way is lost
        self.machine.digest.update(b"%d %s " % (self.machine.now_ns, way.encode()) + data)
        if way == "reply":
            if self.alive:
                self.stream.arrive(data)
            return
        self.asked_ns = self.machine.now_ns
        network.name_sender(self.stream)
        if reply := network.station.received(data):
            target = self if self.alive else next(iter(network.connections), None)  # a late reply of the line
            if target is not None:
                target.carry("reply", reply)

    def reset(self):
        """The adapter is unplugged: the port is readable, and contains no bytes."""
        if self.alive:
            self.alive, self.unplugged = False, True
            self.network.drop(self)
            self.stream.end()


class SerialLine(Network):
    """The serial way to the device; `refuses` is an unplugged adapter."""

    framing = "rtu"

    def __init__(self, machine, amplifier, kernel, path):
        super().__init__(machine, amplifier)
        self.kernel, self.path = kernel, path
        self.station = RtuStation(self.unit, UNIT_ID, lambda: machine.now_ns)
        self.held_by_other = False
        path.touch()

    @property
    def refuses(self):
        return self._refuses

    @refuses.setter
    def refuses(self, unplugged):
        """The name of the port is there while the adapter is plugged in."""
        self._refuses = unplugged
        if hasattr(self, "path"):
            self.path.unlink(missing_ok=True) if unplugged else self.path.touch()

    def open_port(self, port, *arguments, **settings):
        return OpenPort(self, port, *arguments, **settings)


def make_network(plan, machine, kernel, amplifier, folder, port):
    """The way to the device that the plan names."""
    if plan.wire == "rtu":
        line = SerialLine(machine, amplifier, kernel, folder / "serial-by-id")
        kernel.line = line
        return line
    network = Network(machine, amplifier)
    kernel.hosts[port] = network
    return network
