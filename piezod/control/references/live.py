"""References that arrive while the loop runs: a register of the device, or a stream of datagrams."""

import socket
import struct
from math import isfinite
from pathlib import Path

from piezod.config.reference import RegisterReference, StreamReference
from piezod.control.references.reference import Freshness
from piezod.errors import BusyError
from piezod.transport import Reading


class RegisterValue:
    """The register `reference`, which every exchange reads together with the force.

    Parameters
    ----------
    reading
        Reading of the link; every good exchange overwrites it in place.
    config
        Section `reference` of the bench configuration.
    counted
        Whether the device has `reference_counter`. An unchanged counter makes the reference stale.
    """

    def __init__(self, reading: Reading, config: RegisterReference, *, counted: bool) -> None:
        self._reading = reading
        self._stale_ns = round(config.stale_after_s * 1e9)
        self._counted = counted
        self._counter = -1
        self._received_ns = 0
        self.ahead = 0.0
        self.ramp_down_on_lapse = config.when_stale == "ramp_down"
        self.freshness = Freshness.STALE

    def start(self, tick: int) -> None:  # noqa: ARG002  # the same call for every reference
        """Accept the present value of the register as new."""
        self._counter = -1

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Value of the last good reading [N]."""
        reading = self._reading
        if not self._counted or reading.reference_counter != self._counter:
            self._counter = reading.reference_counter
            if isfinite(reading.reference_N):
                self.ahead = reading.reference_N
                self._received_ns = now_ns
        self.freshness = Freshness.LIVE if now_ns - self._received_ns < self._stale_ns else Freshness.STALE
        return self.ahead

    def close(self) -> None:
        """No effect: the link is not this object's."""


class DatagramStream:
    """Datagrams of 24 bytes, little-endian: sequence (uint64), timestamp [ns] (uint64), value [N] (float64).

    Every tick reads the datagrams that have arrived and keeps the highest sequence number.

    Parameters
    ----------
    config
        Section `reference` of the bench configuration.

    Attributes
    ----------
    rejected
        Number of datagrams that were malformed, not finite or out of order.

    Raises
    ------
    BusyError
        The address is in use.
    """

    _DATAGRAM = struct.Struct("<QQd")
    _MOST_PER_TICK = 32

    def __init__(self, config: StreamReference) -> None:
        self._stale_ns = round(config.stale_after_s * 1e9)
        self._buffer = bytearray(64)
        self._sequence = -1
        self._received_ns: int | None = None
        self.ahead = 0.0
        self._path: Path | None = None
        self.rejected = 0
        self.ramp_down_on_lapse = config.when_stale == "ramp_down"
        self.freshness = Freshness.STALE
        self._socket = self._bind(config)

    def _bind(self, config: StreamReference) -> socket.socket:
        address = config.udp_address
        if address is None:
            receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._path = Path(config.listen)
            self._path.unlink(missing_ok=True)
        else:
            receiver = socket.socket(socket.AF_INET6 if ":" in address[0] else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            receiver.bind(config.listen if address is None else address)
        except OSError as error:
            receiver.close()
            raise BusyError(f"reference.listen: {config.listen} cannot be bound: {error.strerror}") from error
        receiver.setblocking(False)
        return receiver

    def start(self, tick: int) -> None:
        """No effect: a value counts from its arrival."""

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Newest value [N]."""
        for _ in range(self._MOST_PER_TICK):
            try:
                size = self._socket.recv_into(self._buffer)
            except (BlockingIOError, InterruptedError):
                break
            self._accept(size, now_ns)
        received = self._received_ns
        live = received is not None and now_ns - received < self._stale_ns
        self.freshness = Freshness.LIVE if live else Freshness.STALE
        return self.ahead

    def _accept(self, size: int, now_ns: int) -> None:
        """Use the first `size` bytes of the buffer as a datagram, or reject them."""
        if size != self._DATAGRAM.size:
            self.rejected += 1
            return
        sequence, _, value = self._DATAGRAM.unpack_from(self._buffer)
        if sequence <= self._sequence or not isfinite(value):
            self.rejected += 1
            return
        self._sequence, self.ahead, self._received_ns = sequence, value, now_ns

    def close(self) -> None:
        """Close the socket and remove a unix socket's path."""
        self._socket.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)
