"""Modbus over TCP: one connection, one request at a time, and a check of every byte of the reply header.

    frame:   [ transaction id | protocol id = 0 | length | unit ][ function | data ]
    bytes:   [       2        |        2        |   2    |  1   ][    1     |  n   ]

A reply with another transaction id belongs to an earlier request and is discarded. After a timeout the connection is
closed, so a late reply cannot reach the next request.
"""

from typing import TYPE_CHECKING

from piezod.config.link import ModbusTcpLink
from piezod.runtime import clock, sockets
from piezod.transport.bad_exchange import BadExchange
from piezod.transport.frames import MBAP_BYTES, Framing, Request, classify
from piezod.transport.hints import tcp_hint
from piezod.transport.link import ExchangeResult
from piezod.transport.port import MOST_STALE_BYTES, RECONNECT_S, send_frame
from piezod.transport.tcp_connection import Connection, Endpoint, connect, connect_to_host, input_waiter
from piezod.transport.tls import TlsStream, make_context

if TYPE_CHECKING:
    import select
    import ssl

RECEIVE_BYTES = 2048  # several frames of the maximum length

_OK = ExchangeResult.OK
_TIMEOUT = ExchangeResult.TIMEOUT
_DISCONNECTED = ExchangeResult.DISCONNECTED


class TcpWire:
    """A TCP connection to one Modbus device, used by `ModbusLink`.

    Parameters
    ----------
    config
        Host, port, unit and time limits.
    """

    __slots__ = (
        "_buffer",
        "_config",
        "_context",
        "_endpoint",
        "_not_before_s",
        "_received",
        "_socket",
        "_transaction",
        "_waiter",
        "answered",
        "bad_exchange",
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
        self._waiter: select.poll | TlsStream = sockets.poll()
        self._context: ssl.SSLContext | None = None
        self._endpoint: Endpoint | None = None
        self._buffer = bytearray(RECEIVE_BYTES)
        self.payload = memoryview(self._buffer)
        self._transaction = 0
        self._not_before_s = 0.0
        self.generation = self.exception_code = self.stale_bytes = 0
        self.hint = ""
        self.answered = False
        self._received = 0  # bytes of the last reply, whole or not
        self.bad_exchange = BadExchange()

    @property
    def description(self) -> str:
        """Kind and address of the link, for messages."""
        kind = "modbus_tcp" if self._config.tls is None else "modbus_tcp with tls"
        return f"{kind} {self._config.host}:{self._config.port} unit {self._config.unit_id}"

    def open(self) -> None:
        """Resolve the host and connect; raises as `connect_to_host`."""
        self.close()
        if self._config.tls is not None:
            self._context = make_context(self._config.tls)
        connection, self._endpoint = connect_to_host(self._config, self._context)
        self._take(connection)

    def close(self) -> None:
        """Disconnect and stay disconnected until the next `open`."""
        self._disconnect()
        self._endpoint = None

    def ensure_open(self, deadline_s: float) -> ExchangeResult:
        """Reconnect if disconnected: after a single late reply at once, otherwise at most every 50 ms."""
        if self._socket is not None:
            return _OK
        now_s = clock.monotonic()
        if self._endpoint is None or now_s < self._not_before_s:
            return _DISCONNECTED
        self._not_before_s = now_s + RECONNECT_S
        try:
            self._take(connect(self._config, self._endpoint, self._context, deadline_s))
        except OSError:
            return _DISCONNECTED
        return _OK

    def transact(self, request: Request, deadline_s: float) -> ExchangeResult:
        """Send `request` and receive the reply into `payload`."""
        connection = self._socket
        if connection is None:
            return _DISCONNECTED
        frame, head = request.frame, request.reply_head
        self._transaction = transaction = self._transaction % 65535 + 1
        frame[0] = head[0] = transaction >> 8
        frame[1] = head[1] = transaction & 255
        self._received = 0
        try:
            if self._waiter.poll(0) and not self._drain(connection):
                self._disconnect()
                return _DISCONNECTED
            send_frame(connection.send, connection, frame, deadline_s)
            result = self._receive(connection, request, deadline_s)
        except OSError:
            result = _DISCONNECTED
        if result is not _OK:
            self.bad_exchange.keep(result, frame, self._buffer, self._received)
            self.hint = "" if self.answered else tcp_hint(result, self.payload[: self._received], request)
            self._after_failure(result)
        return result

    def _receive(self, connection: Connection, request: Request, deadline_s: float) -> ExchangeResult:
        """Wait for the valid reply; discard replies to earlier requests."""
        buffer, view, head, size = self._buffer, self.payload, request.reply_head, request.reply_size
        received, other_replies, space = 0, 0, view
        while True:
            if not self._waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))):
                return ExchangeResult.WRONG_TRANSACTION if other_replies else _TIMEOUT
            try:
                count = connection.recv_into(space)
            except BlockingIOError:  # the socket has no data
                continue
            if count == 0:
                return _DISCONNECTED
            self._received = received = received + count
            while not (received >= size and buffer.startswith(head)):
                failure, used = self._classify_first_frame(request, received)
                if failure is not _OK:
                    return failure
                if used == 0:
                    break
                other_replies += 1
                self.stale_bytes += used
                view[: received - used] = bytes(view[used:received])
                received -= used
                self._received = received or used
            else:
                self.stale_bytes += received - size
                self.answered = True
                self.hint = ""
                return _OK
            space = view[received:]

    def _classify_first_frame(self, request: Request, received: int) -> tuple[ExchangeResult, int]:
        """Classify the first received frame, which is not the valid reply.

        Returns
        -------
        tuple
            OK and 0: incomplete. OK and a length: reply to another request, to be discarded. Otherwise the error and 0.
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
        """Discard unrequested bytes; False: the device closed the connection or sends without end."""
        most = self.stale_bytes + MOST_STALE_BYTES
        while self.stale_bytes < most:
            count = connection.recv_into(self.payload)
            self.stale_bytes += count
            if count == 0:
                return False
            if not self._waiter.poll(0):
                return True
        return False

    def _after_failure(self, result: ExchangeResult) -> None:
        """Close the connection if a late reply may follow; after a single timeout, allow an immediate reconnection."""
        if result is ExchangeResult.DEVICE_EXCEPTION or self._socket is None:
            return
        if isinstance(self._socket, TlsStream) and self._socket.reason:
            self.hint = f"the device ended TLS: {self._socket.reason}; check both certificates"
        if result in (_TIMEOUT, _DISCONNECTED, ExchangeResult.WRONG_TRANSACTION, ExchangeResult.MALFORMED):
            if result is _TIMEOUT and self.answered:
                self._not_before_s = 0.0
            self._disconnect()

    def _take(self, connection: Connection) -> None:
        """Use a new connection from now on."""
        self._socket = connection
        self._waiter = input_waiter(connection)
        self.generation += 1
        self.answered = False

    def _disconnect(self) -> None:
        if self._socket is None:
            return
        self._socket.close()
        self._socket = None
