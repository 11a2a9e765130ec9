"""Modbus RTU over a serial port or a gateway; frames have no number, so every byte and the checksum are compared.

    frame:   [ unit ][ function | data ][ CRC, low byte first ]
    bytes:   [  1   ][    1     |  n   ][         2           ]
    between two frames: silence of at least 3.5 characters

Bytes that do not match the expected reply are collected until the line is silent, classified and discarded.
"""

from piezod.config.link import ModbusRtuLink, RtuOverTcpLink
from piezod.runtime import clock
from piezod.transport.bad_exchange import BadExchange
from piezod.transport.frames import CRC_BYTES, Framing, Request, classify, crc16
from piezod.transport.hints import SHORTEST_FRAME_BYTES, rtu_hint
from piezod.transport.link import ExchangeResult
from piezod.transport.port import RECEIVE_BYTES
from piezod.transport.serial_port import SerialPort
from piezod.transport.tcp_port import TcpPort
from piezod.transport.wire_rate import gap_s

QUIET_S = 0.004  # above the gap of 1.75 ms between frames; adapters deliver bytes in groups
OVERSLEEP_S = 0.0001  # the kernel may wake the process this late; the rest of a gap is a busy wait
BAD_IN_A_ROW = 5  # wrong checksums in a row that indicate wrong line settings

_OK = ExchangeResult.OK
_TIMEOUT = ExchangeResult.TIMEOUT
_BAD_CRC = ExchangeResult.BAD_CRC


class RtuWire:
    """A serial line with one or more Modbus devices, used by `ModbusLink`.

    Parameters
    ----------
    config
        Port or gateway, character format, unit and time limits.
    """

    __slots__ = (
        "_bad_crc_in_a_row",
        "_config",
        "_gap_s",
        "_port",
        "_quiet_s",
        "_received",
        "answered",
        "bad_exchange",
        "exception_code",
        "hint",
        "payload",
    )
    framing: Framing = "rtu"

    def __init__(self, config: ModbusRtuLink | RtuOverTcpLink) -> None:
        self._config = config
        self._port: SerialPort | TcpPort = SerialPort(config) if isinstance(config, ModbusRtuLink) else TcpPort(config)
        self._gap_s = gap_s(config)
        self._quiet_s = 0.0
        self._bad_crc_in_a_row = 0
        self.payload = self._port.view
        self.exception_code = 0
        self.hint = ""
        self.answered = False
        self._received = 0  # bytes of the last reply, whole or not
        self.bad_exchange = BadExchange()

    @property
    def description(self) -> str:
        """Kind and address of the link, for messages."""
        config = self._config
        if isinstance(config, RtuOverTcpLink):
            return f"rtu_over_tcp {config.host}:{config.port} unit {config.unit_id}"
        return f"modbus_rtu {config.port} {config.baudrate} baud unit {config.unit_id}"

    @property
    def generation(self) -> int:
        """Number of times the port was opened."""
        return self._port.generation

    @property
    def stale_bytes(self) -> int:
        """Number of discarded bytes."""
        return self._port.stale_bytes

    def open(self) -> None:
        """Open and lock the port; raises UnreachableError or BusyError."""
        self._port.open()
        self.answered = False

    def close(self) -> None:
        """Close the port until the next `open`."""
        self._port.close()

    def ensure_open(self, deadline_s: float) -> ExchangeResult:
        """Reopen the port if necessary; DISCONNECTED while a late reply is possible."""
        return self._port.ensure_open(deadline_s)

    def transact(self, request: Request, deadline_s: float) -> ExchangeResult:
        """Send `request` and receive the reply into `payload`."""
        port, frame = self._port, request.frame
        checksum = crc16(request.values, request.checksum)
        frame[-2], frame[-1] = checksum & 255, checksum >> 8
        while (pause_s := self._quiet_s - clock.monotonic()) > 0.0:
            if pause_s > OVERSLEEP_S:
                clock.sleep(pause_s - OVERSLEEP_S)
        self._received = 0
        try:
            port.drain()
            port.send(frame, deadline_s)
            result = self._receive(request, deadline_s)
        except OSError:
            self.bad_exchange.keep(ExchangeResult.DISCONNECTED, frame, port.buffer, self._received)
            port.close_lost()
            return ExchangeResult.DISCONNECTED
        self._quiet_s = clock.monotonic() + self._gap_s
        if result is not _OK:
            self.bad_exchange.keep(result, frame, port.buffer, self._received)
            self._after_failure(request, result, deadline_s)
        return result

    def _receive(self, request: Request, deadline_s: float) -> ExchangeResult:
        """Receive the complete valid reply; collect and classify anything else."""
        port, buffer, head, size = self._port, self._port.buffer, request.reply_head, request.reply_size
        received = 0
        while received < size:
            if not port.wait(deadline_s):
                return self._classify_received(request, received)
            self._received = received = received + port.receive(received)
            if not buffer.startswith(head if received >= len(head) else head[:received]):
                return self._classify_received(request, self._collect(request, received, deadline_s))
        if not buffer.startswith(head) or crc16(port.view[request.reply_fixed : size], request.reply_checksum):
            return self._classify_received(request, self._collect(request, received, deadline_s))
        port.stale_bytes += received - size
        self.answered = True
        self._bad_crc_in_a_row = 0
        self.hint = ""
        return _OK

    def _collect(self, request: Request, received: int, deadline_s: float) -> int:
        """Receive until a frame is complete, or until the line is silent after the length of the expected reply.

        With fewer bytes, the reply may still follow, and only the deadline ends the wait.
        """
        port, size = self._port, max(request.reply_size, len(request.frame))
        while received < RECEIVE_BYTES:
            if _is_frame(port.view, received) and not port.buffer.startswith(request.frame):
                break
            until_s = min(deadline_s, clock.monotonic() + QUIET_S) if received >= size else deadline_s
            if not port.wait(until_s):
                break
            self._received = received = received + port.receive(received)
        return received

    def _classify_received(self, request: Request, received: int) -> ExchangeResult:
        """Classify the received bytes, which are not the valid reply."""
        port, frame = self._port, request.frame
        port.stale_bytes += received
        if received == 0:
            return _TIMEOUT
        if received >= len(frame) and port.buffer.startswith(frame):
            self.hint = "the request itself comes back: switch off the local echo of the RS-485 adapter"
            return ExchangeResult.MALFORMED
        if _is_frame(port.view, received):
            self.answered = True
            result, code = classify(port.buffer, request, received - CRC_BYTES)
            self.exception_code = code or self.exception_code
            return result
        if received < request.reply_size and request.reply_head.startswith(
            port.buffer[: min(received, len(request.reply_head))]
        ):
            return _TIMEOUT
        self._bad_crc_in_a_row += 1
        self.hint = rtu_hint(port.view[:received], request)
        if not self.hint and self._bad_crc_in_a_row >= BAD_IN_A_ROW:
            self.hint = f"{self._bad_crc_in_a_row} bad checksums in a row: check baudrate and parity"
        return _BAD_CRC

    def _after_failure(self, request: Request, result: ExchangeResult, deadline_s: float) -> None:
        """Close and settle the line, unless the complete reply has arrived: damaged, or a Modbus exception."""
        if result is ExchangeResult.DEVICE_EXCEPTION:
            self._bad_crc_in_a_row = 0
        elif result is not _BAD_CRC or clock.monotonic() >= deadline_s:
            config = self._config
            reply_s = request.reply_size * config.bits_per_character / config.baudrate
            self._port.close_and_settle(config.timeout_s + reply_s)


def _is_frame(view: memoryview, received: int) -> bool:
    return received >= SHORTEST_FRAME_BYTES and crc16(view[:received]) == 0
