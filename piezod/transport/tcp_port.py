"""A TCP connection to a serial gateway, with the methods of a serial port: RTU frames pass through it as they are.

A gateway does not number its replies, and may still hold a late one after the connection is opened again.
"""

import socket

from piezod.config.link import RtuOverTcpLink
from piezod.runtime import clock
from piezod.transport.port import Port
from piezod.transport.tcp_connection import Endpoint, connect, connect_to_host


class TcpPort(Port):
    """One TCP connection, used by `RtuWire`.

    Parameters
    ----------
    config
        Host, port and time limits.
    """

    __slots__ = ("_config", "_endpoint", "_socket")

    def __init__(self, config: RtuOverTcpLink) -> None:
        super().__init__()
        self._config = config
        self._socket: socket.socket | None = None
        self._endpoint: Endpoint | None = None

    def open(self) -> None:
        """Resolve the host and connect; raises as `connect_to_host`."""
        self.close()
        connection, self._endpoint = connect_to_host(self._config, None)
        self._take(connection)
        self._shall_be_open = True

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

    def _connect(self, deadline_s: float) -> None:
        assert self._endpoint is not None
        limit_s = min(deadline_s, clock.monotonic() + self._config.connect_timeout_s)
        self._take(connect(self._config, self._endpoint, None, limit_s))

    def _take(self, connection: object) -> None:
        assert isinstance(connection, socket.socket)
        self._socket = connection
        self._use(connection)

    def _write(self, frame: bytearray | bytes) -> int:
        if self._socket is None:
            raise ConnectionError
        return self._socket.send(frame)

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
