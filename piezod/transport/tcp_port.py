"""A TCP connection to a serial gateway, with the methods of a serial port: RTU frames pass through it as they are.

A gateway does not number its replies, as a serial line does not. After a timeout the connection is therefore closed,
and after it is opened again the bytes of the settling time are discarded: the gateway may still hold a late reply.
"""

import contextlib
import select
import socket
from math import inf

from piezod.config.link import RtuOverTcpLink
from piezod.errors import BusyError, ConfigurationError
from piezod.runtime import clock, sockets
from piezod.transport.link import ExchangeResult
from piezod.transport.serial_port import MOST_STALE_BYTES, RECEIVE_BYTES
from piezod.transport.tcp_connection import Address, connect, connection_error, is_turned_away, resolve

RECONNECT_S = 0.05  # shortest time between two attempts to connect

_OK = ExchangeResult.OK
_DISCONNECTED = ExchangeResult.DISCONNECTED


class TcpPort:
    """One TCP connection, used by `RtuWire`.

    Parameters
    ----------
    config
        Host, port and time limits.

    Attributes
    ----------
    buffer, view
        Receive buffer and a view of the same memory.
    generation
        Number of connections so far.
    stale_bytes
        Number of discarded bytes.
    """

    __slots__ = (
        "_address",
        "_config",
        "_family",
        "_not_before_s",
        "_settled_at_s",
        "_socket",
        "_waiter",
        "buffer",
        "generation",
        "stale_bytes",
        "view",
    )

    def __init__(self, config: RtuOverTcpLink) -> None:
        self._config = config
        self._socket: socket.socket | None = None
        self._waiter = sockets.poll()
        self._family = socket.AF_INET
        self._address: Address = None
        self._not_before_s = self._settled_at_s = 0.0
        self.buffer = bytearray(RECEIVE_BYTES)
        self.view = memoryview(self.buffer)
        self.generation = self.stale_bytes = 0

    def open(self) -> None:
        """Resolve the host and connect to its first address that accepts.

        Raises
        ------
        UnreachableError
            The host is unknown, refuses, or does not answer within `connect_timeout_s`.
        BusyError
            The gateway closed the connection at once.
        ConfigurationError
            The host name leads to a routable address.
        """
        self.close()
        deadline_s, failure = clock.monotonic() + self._config.connect_timeout_s, OSError("no address")
        for family, _, _, _, address in resolve(self._config):
            if message := self._config.plaintext_refusal(address[0]):
                raise ConfigurationError(f"link.{message}")
            self._family, self._address = family, address
            try:
                connection = self._connect(deadline_s)
                turned_away = is_turned_away(connection, self._waiter)
            except ConnectionResetError:
                turned_away = True
            except OSError as error:
                self._release()
                failure = error
                continue
            if not turned_away:
                return
            self.close()
            where = f"link: {self._config.host}:{self._config.port}"
            raise BusyError(
                f"{where} closed the connection at once: another client may hold the gateway; stop it first"
            )
        self.close()
        raise connection_error(self._config, failure) from failure

    def close(self) -> None:
        """Close the connection until the next `open`."""
        self._release()
        self._address = None
        self._not_before_s = self._settled_at_s = 0.0

    def ensure_open(self, deadline_s: float = inf) -> ExchangeResult:
        """Connect again if necessary; DISCONNECTED while the gateway is away or a late reply is possible."""
        now_s = clock.monotonic()
        if self._socket is None:
            if self._address is None or now_s < self._not_before_s:
                return _DISCONNECTED
            self._not_before_s = now_s + RECONNECT_S
            try:
                self._connect(min(deadline_s, now_s + self._config.connect_timeout_s))
            except OSError:
                self._release()
                return _DISCONNECTED
        if now_s >= self._settled_at_s:
            return _OK
        try:
            self.drain()
        except OSError:
            self._release()
        return _DISCONNECTED

    def close_and_settle(self, settle_s: float) -> None:
        """Close the connection; after the next one, discard all bytes until `settle_s` from now [s]."""
        self._release()
        self._not_before_s = 0.0
        self._settled_at_s = clock.monotonic() + settle_s

    def close_lost(self) -> None:
        """Close a connection that broke; the next attempt follows after `RECONNECT_S`."""
        self._release()
        self._not_before_s = clock.monotonic() + RECONNECT_S

    def wait(self, deadline_s: float) -> bool:
        """Wait for input until `deadline_s` on the monotonic clock; False: none."""
        return bool(self._waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))))

    def receive(self, at: int) -> int:
        """Read the available bytes into `buffer`, starting at byte `at`.

        Raises
        ------
        ConnectionError
            The gateway closed the connection.
        """
        connection = self._socket
        if connection is None:
            raise ConnectionError
        count = connection.recv_into(self.view[at:])
        if count == 0:
            raise ConnectionError
        return count

    def drain(self) -> None:
        """Discard unrequested bytes; raises OSError if the connection broke or receives without end."""
        most = self.stale_bytes + MOST_STALE_BYTES
        while self._waiter.poll(0):
            self.stale_bytes += self.receive(0)
            if self.stale_bytes > most:
                raise ConnectionError

    def send(self, frame: bytearray | bytes, deadline_s: float) -> None:
        """Send a complete frame; raises OSError if the connection broke, or the deadline passes before the end."""
        connection = self._socket
        if connection is None:
            raise ConnectionError
        if clock.monotonic() >= deadline_s:
            raise TimeoutError
        sent = 0
        while True:
            with contextlib.suppress(BlockingIOError):
                sent += connection.send(frame[sent:] if sent else frame)
            if sent == len(frame):
                return
            waiter = sockets.poll()
            waiter.register(connection, select.POLLOUT)
            if not waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))):
                raise TimeoutError

    def _connect(self, deadline_s: float) -> socket.socket:
        """Connect until the deadline; raises OSError."""
        connection = connect(self._config, self._family, self._address, None, deadline_s)
        assert isinstance(connection, socket.socket)
        self._socket = connection
        self._waiter.register(connection, select.POLLIN)
        self.generation += 1
        return connection

    def _release(self) -> None:
        if self._socket is None:
            return
        self._waiter.unregister(self._socket)
        self._socket.close()
        self._socket = None
