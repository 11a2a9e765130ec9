"""Modbus over TCP: one connection, one request at a time, every byte of the reply's header compared.

    [ transaction id | protocol id = 0 | length | unit ][ function | data ]
           2 bytes          2 bytes      2 bytes   1          1       n

A reply without its own transaction id was meant for another request and is discarded. After a timeout the connection is
closed, so what comes late has nowhere to arrive.
"""

import contextlib
import os
import select
import socket
import ssl
from time import monotonic
from typing import Any

from piezod.config.link import ModbusTcpLink
from piezod.errors import BusyError, ConfigurationError, UnreachableError
from piezod.transport.frames import MBAP_BYTES, Framing, Request, classify
from piezod.transport.link import ExchangeResult
from piezod.transport.tls import REFUSAL_S as TLS_REFUSAL_S
from piezod.transport.tls import TlsStream, make_context, refusal

RECONNECT_S = 0.05  # between two attempts to connect; a tick is no place to hammer a dead device
REFUSAL_S = 0.01  # a device that serves one client closes a second connection at once
RECEIVE_BYTES = 2048  # several of the longest frames
MOST_STALE_BYTES = 65536  # a peer that sends more unasked is no Modbus device

_OK = ExchangeResult.OK
_TIMEOUT = ExchangeResult.TIMEOUT
_DISCONNECTED = ExchangeResult.DISCONNECTED


Connection = socket.socket | TlsStream


class TcpWire:
    """A TCP connection to one Modbus device.

    Parameters
    ----------
    config
        Host, port, unit and time limits.
    """

    __slots__ = (
        "_address",
        "_buffer",
        "_config",
        "_context",
        "_family",
        "_not_before_s",
        "_poll",
        "_socket",
        "_transaction",
        "answered",
        "exception_code",
        "generation",
        "hint",
        "payload",
        "stale_bytes",
    )
    framing: Framing = "tcp"

    def __init__(self, config: ModbusTcpLink) -> None:
        self._config = config
        self._socket: Connection | None = None
        self._poll: select.poll | TlsStream = select.poll()
        self._context: ssl.SSLContext | None = None
        self._family = socket.AF_INET
        self._address: Any = None
        self._buffer = bytearray(RECEIVE_BYTES)
        self.payload = memoryview(self._buffer)
        self._transaction = 0
        self._not_before_s = 0.0
        self.generation = self.exception_code = self.stale_bytes = 0
        self.hint = ""
        self.answered = False

    @property
    def description(self) -> str:
        """Kind and address, for people."""
        kind = "modbus_tcp" if self._config.tls is None else "modbus_tcp with tls"
        return f"{kind} {self._config.host}:{self._config.port} unit {self._config.unit_id}"

    def open(self) -> None:
        """Resolve the host and connect.

        Raises
        ------
        UnreachableError
            Unknown host, refused, or no answer within `connect_timeout_s`.
        BusyError
            The device closed the connection at once.
        """
        self.close()
        host, port = self._config.host, self._config.port
        if self._config.tls is not None:
            self._context = make_context(self._config.tls)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            raise UnreachableError(
                f"link: {host}:{port} cannot be resolved ({error}): check link.host and the name server"
            ) from error
        self._connect_first(found, monotonic() + self._config.connect_timeout_s)

    def _connect_first(self, found: list[Any], deadline_s: float) -> None:
        """Connect to the first address that takes the connection; a name may stand for several."""
        failure = OSError("no address")
        for family, _, _, _, address in found:
            self._family, self._address = family, address
            if words := self._config.refusal_of(address[0]):
                raise ConfigurationError(f"link.{words}")
            try:
                self._connect(deadline_s)
                turned_away = self._is_turned_away()
            except ConnectionResetError:
                turned_away = True
            except OSError as error:
                self._disconnect()
                failure = error
                continue
            if not turned_away:
                return
            self.close()
            where = f"link: {self._config.host}:{self._config.port}"
            doubt = "" if self._context is None else ", or it refuses link.tls.certificate"
            raise BusyError(
                f"{where} closed the connection at once: another client may hold the device{doubt}; stop it first"
            )
        self.close()
        raise refusal(self._config, failure) or UnreachableError(self._explain(failure)) from failure

    def _explain(self, error: OSError) -> str:
        """Say why there is no connection."""
        where = f"link: {self._config.host}:{self._config.port}"
        if isinstance(error, ConnectionRefusedError):
            return f"{where} refused the connection: is the device on, and the port right?"
        if isinstance(error, TimeoutError):
            limit_s = self._config.connect_timeout_s
            return f"{where} did not answer within {limit_s:g} s: check cable, address and firewall"
        return f"{where}: {error.strerror or error}: check network and address"

    def close(self) -> None:
        """Disconnect, until the next `open`."""
        self._disconnect()
        self._address = None

    def ready(self, deadline_s: float) -> ExchangeResult:
        """Connect again if the connection is gone, at most every 50 ms unless only one reply was late."""
        if self._socket is not None:
            return _OK
        now_s = monotonic()
        if self._address is None or now_s < self._not_before_s:
            return _DISCONNECTED
        self._not_before_s = now_s + RECONNECT_S
        try:
            self._connect(deadline_s)
        except OSError:
            self._disconnect()
            return _DISCONNECTED
        return _OK

    def transact(self, request: Request, deadline_s: float) -> ExchangeResult:
        """Send `request` and receive its reply into `payload`."""
        connection = self._socket
        if connection is None:
            return _DISCONNECTED
        frame, head = request.frame, request.reply_head
        self._transaction = transaction = self._transaction % 65535 + 1
        frame[0] = head[0] = transaction >> 8
        frame[1] = head[1] = transaction & 255
        try:
            if self._poll.poll(0) and not self._drain(connection):
                self._disconnect()
                return _DISCONNECTED
            if monotonic() >= deadline_s:  # stopped meanwhile: what is sent now would be stale
                raise TimeoutError  # answered below as any failure
            sent = _send(connection, frame)
            if sent != len(frame):
                self._send_rest(connection, frame, sent, deadline_s)
            result = self._receive(connection, request, deadline_s)
        except OSError:
            result = _DISCONNECTED
        if result is not _OK:
            self._after_failure(result)
        return result

    def _receive(self, connection: Connection, request: Request, deadline_s: float) -> ExchangeResult:
        """Wait for the reply; the good one, whole and alone, takes the first branch."""
        buffer, view, head, size = self._buffer, self.payload, request.reply_head, request.reply_size
        received, strangers, space = 0, 0, view
        while True:
            if not self._poll.poll(max(0.0, 1e3 * (deadline_s - monotonic()))):
                return ExchangeResult.WRONG_TRANSACTION if strangers else _TIMEOUT
            try:
                count = connection.recv_into(space)
            except BlockingIOError:  # woken for nothing
                continue
            if count == 0:
                return _DISCONNECTED
            received += count
            while not (received >= size and buffer.startswith(head)):
                verdict, used = self._judge(request, received)
                if verdict is not _OK:
                    return verdict
                if used == 0:
                    break
                strangers += 1
                self.stale_bytes += used
                view[: received - used] = bytes(view[used:received])
                received -= used
            else:
                self.stale_bytes += received - size
                self.answered = True
                return _OK
            space = view[received:]

    def _judge(self, request: Request, received: int) -> tuple[ExchangeResult, int]:
        """Say what is wrong with the first frame received.

        Returns
        -------
        tuple
            OK and 0: not whole yet. OK and a length: a reply to another request, to be discarded. Else what is wrong.
        """
        buffer, head = self._buffer, request.reply_head
        if received < MBAP_BYTES:
            return _OK, 0
        length = buffer[4] << 8 | buffer[5]
        if buffer[2] or buffer[3] or not 3 <= length <= 254:
            return ExchangeResult.MALFORMED, 0
        if received < 6 + length:
            return _OK, 0
        if buffer[0] != head[0] or buffer[1] != head[1]:
            return _OK, 6 + length
        self.stale_bytes += received - 6 - length
        self.answered = True
        result, code = classify(buffer, request, 6 + length)
        self.exception_code = code or self.exception_code
        return result, 0

    def _drain(self, connection: Connection) -> bool:
        """Discard what came unasked; False when the other side has closed or does not stop."""
        most = self.stale_bytes + MOST_STALE_BYTES
        while self.stale_bytes < most:
            count = connection.recv_into(self.payload)
            self.stale_bytes += count
            if count == 0:
                return False
            if not self._poll.poll(0):
                return True
        return False

    def _send_rest(self, connection: Connection, frame: bytearray, sent: int, deadline_s: float) -> None:
        """Send what the kernel did not take at once; raises TimeoutError."""
        waiter = select.poll()
        waiter.register(connection, select.POLLOUT)
        while sent < len(frame):
            if not waiter.poll(max(0.0, 1e3 * (deadline_s - monotonic()))):
                raise TimeoutError
            sent += _send(connection, frame[sent:])

    def _after_failure(self, result: ExchangeResult) -> None:
        """Close what can no longer be trusted; after one late reply the next attempt to connect need not wait."""
        if result is ExchangeResult.DEVICE_EXCEPTION or self._socket is None:
            return
        if isinstance(self._socket, TlsStream) and self._socket.reason:
            self.hint = f"the device ended TLS: {self._socket.reason}; check both certificates"
        if result in (_TIMEOUT, _DISCONNECTED, ExchangeResult.WRONG_TRANSACTION, ExchangeResult.MALFORMED):
            if result is _TIMEOUT and self.answered:
                self._not_before_s = 0.0
            self._disconnect()

    def _connect(self, deadline_s: float) -> None:
        """Connect until the deadline; raises OSError."""
        connection = socket.socket(self._family, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        self._socket = connection
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with contextlib.suppress(BlockingIOError):
            connection.connect(self._address)
        waiter = select.poll()
        waiter.register(connection, select.POLLOUT)
        if not waiter.poll(max(0.0, 1e3 * (deadline_s - monotonic()))):
            raise TimeoutError
        error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error:
            raise OSError(error, os.strerror(error))
        if self._context is not None:
            name = self._config.tls.server_name if self._config.tls is not None else None
            self._socket = self._poll = TlsStream(connection, self._context, name or self._config.host, deadline_s)
        else:
            self._poll = select.poll()
            self._poll.register(connection, select.POLLIN)
        self.generation += 1
        self.answered = False

    def _is_turned_away(self) -> bool:
        """Whether the device closes the connection at once, as one that serves a single client does to a second."""
        connection = self._socket
        assert connection is not None
        if isinstance(connection, TlsStream):
            if connection.poll(1e3 * TLS_REFUSAL_S) and connection.reason:
                raise ssl.SSLError(1, connection.reason)
            return connection.ended
        return bool(self._poll.poll(1e3 * REFUSAL_S)) and not connection.recv(1, socket.MSG_PEEK)

    def _disconnect(self) -> None:
        if self._socket is None:
            return
        self._socket.close()
        self._socket = None


def _send(connection: Connection, frame: bytearray) -> int:
    """How much of the frame the kernel takes now; none when its buffer is full."""
    try:
        return connection.send(frame)
    except BlockingIOError:
        return 0
