"""The reference that arrives as datagrams, over UDP or a unix socket (`datagram.py` has the format)."""

import contextlib
import socket
from pathlib import Path

from piezod.config.reference import StreamReference
from piezod.config.reference_range import ReferenceRange
from piezod.config.run_time_files import UnixSocket
from piezod.control.references.datagram import LARGEST, DatagramGate, read_key
from piezod.control.references.live import LiveReference
from piezod.errors import BusyError
from piezod.runtime import sockets

_MOST_PER_TICK = 32
_MOST_DISCARDED = 10_000  # queues of the kernel are shorter
_RECEIVE_BYTES = 65_536  # a short queue of the kernel: a value that waits in it is late


class DatagramStream(LiveReference):
    """Newest value of a stream of datagrams.

    The socket is emptied in every tick, also at rest, so the age of a value counts from its arrival. What waits in the
    socket when the bench is armed is discarded, and a sender may then begin with any sequence number.

    Parameters
    ----------
    config
        Section `reference` of the bench configuration.
    allowed
        Range of the reference; a value beyond it is refused and counted. It is not clamped: a wrong value would then
        drive to the limit.

    Raises
    ------
    BusyError
        The address is in use.
    ConfigurationError
        The path names something else than an own socket, or the shared key cannot be used.
    """

    def __init__(self, config: StreamReference, allowed: ReferenceRange) -> None:
        super().__init__(config.stale_after_s, config.when_stale)
        key = None if config.key_file is None else read_key(config.key_file)
        self._gate = DatagramGate(allowed, key, config.stamp_within_s)
        self._buffer = bytearray(LARGEST + 1)
        self._view = memoryview(self._buffer)
        self._unix: UnixSocket | None = None
        self._socket = self._bind(config)

    def _bind(self, config: StreamReference) -> socket.socket:
        address = config.udp_address
        if address is None:
            access = config.socket_mode, config.socket_group
            self._unix = UnixSocket(socket.SOCK_DGRAM, Path(config.listen), "reference.listen", *access)
            return self._unix.socket
        receiver = sockets.socket(socket.AF_INET6 if ":" in address[0] else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            receiver.bind(address)
        except OSError as error:
            receiver.close()
            raise BusyError(f"reference.listen: {config.listen} cannot be bound: {error.strerror}") from error
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        receiver.setblocking(False)
        return receiver

    def begin(self) -> None:
        """Discard what waits in the socket, and accept any sequence number next."""
        with contextlib.suppress(BlockingIOError):
            for _ in range(_MOST_DISCARDED):
                self._socket.recv_into(self._buffer)
        self._gate.begin()

    def idle(self, now_ns: int) -> None:
        """Take the datagrams that have arrived."""
        for _ in range(_MOST_PER_TICK):
            try:
                size = self._socket.recv_into(self._buffer)
            except (BlockingIOError, InterruptedError):
                break
            self._count(self._gate.check(self._view[:size], now_ns), self._gate.value_N, now_ns)

    def close(self) -> None:
        """Close the socket and remove a unix socket's path."""
        self._socket.close()
        if self._unix is not None:
            self._unix.close()
