r"""Link to a device with an ASCII line protocol on a serial port.

Example::

    to the device    SVA A 10.000\n    set the voltage
    to the device    VOL? A\n          request a reading
    from the device  9.998\n
"""

import re
from math import inf, nan
from typing import Any

from piezod.config.checked import shortened
from piezod.config.link import SerialLineLink
from piezod.errors import CheckFailedError, ConfigurationError, IdentityError, UnreachableError
from piezod.runtime import clock
from piezod.transport.bad_exchange import BadExchange
from piezod.transport.line_guard import WATCHDOG, LineGuard
from piezod.transport.line_reply import ROLES, ReplyFields, decimal
from piezod.transport.line_template import query_of, template_of
from piezod.transport.link import ACKNOWLEDGED, ANY, ExchangeResult, Reading
from piezod.transport.port import RECEIVE_BYTES
from piezod.transport.serial_port import SerialPort
from piezod.transport.tick_values import Plausibility

SET_UP_TIMEOUT_S = 0.5  # shortest time limit of a set-up exchange

_OK = ExchangeResult.OK


class SerialLineDevice:
    """Sets the voltage by one line and reads by another line, both within one timeout.

    Parameters
    ----------
    config
        The `link` section.

    Raises
    ------
    ConfigurationError
        A line template or a reply pattern is invalid.
    """

    __slots__ = (
        "_acknowledge",
        "_config",
        "_exchange_generation",
        "_fields",
        "_guard",
        "_identity",
        "_measure",
        "_pattern",
        "_plausibility",
        "_port",
        "_received",
        "_set_up",
        "_set_up_generation",
        "_set_up_line",
        "_set_voltage",
        "_terminator",
        "_watchdog",
        "_watchdog_reply",
        "bad_exchange",
        "counts",
        "hint",
        "reading",
        "time_limit_s",
        "written_V",
    )
    last_exception = 0
    output_confirmed = False  # one device: the result of the exchange says it
    holds_command = False

    def __init__(self, config: SerialLineLink) -> None:
        self._config, self._port = config, SerialPort(config)
        self._terminator = (end := config.terminator).encode("ascii")
        self._set_voltage, self._acknowledge = template_of(config.set_voltage, "voltage_V", end, "link.set_voltage")
        self._watchdog, self._watchdog_reply = template_of(config.watchdog, WATCHDOG, end, "link.watchdog")
        self._measure, self._pattern = query_of(config.measure, end, "link.measure", ROLES)
        self._identity = query_of(config.identity, end, "link.identity")
        self._set_up = [query_of(command, end, "link.setup") for command in config.setup]
        self._fields = ReplyFields(self._pattern)
        self._plausibility = Plausibility(self._fields.roles - {"command_echo"}, config.heartbeat_within_s)
        self.reading: Reading = self._plausibility.reading
        self._set_up_generation = -1
        self._exchange_generation = ANY  # opening of the port at the last good exchange
        self._set_up_line = 0
        self._guard = LineGuard(self._exchange_line, self._identity, (self._watchdog, self._watchdog_reply))
        self.counts = [0] * len(ExchangeResult)
        self.written_V = nan
        self.time_limit_s = inf
        self.hint = ""
        self._received = 0  # bytes of the last reply, whole or not
        self.bad_exchange = BadExchange()

    def keep_bad_exchange_in(self, cells: Any, link: int = 0) -> None:  # noqa: ANN401  # any object with the buffer protocol
        """Write the bytes of failed exchanges into this memory from now on."""
        self.bad_exchange.use(cells, link)

    @property
    def description(self) -> str:
        """Kind and address of the link, for messages."""
        return f"serial_line {self._config.port} {self._config.baudrate} baud"

    @property
    def stale_bytes(self) -> int:
        """Number of discarded bytes: unrequested or too late."""
        return self._port.stale_bytes

    def open(self) -> None:
        """Open and lock the port, and send the lines of `setup`; raises UnreachableError or BusyError."""
        self._port.open()
        self._exchange_generation = ANY
        self._plausibility.forget_heartbeat()
        result = self._ensure_set_up(clock.monotonic() + max(SET_UP_TIMEOUT_S, self._config.timeout_s))
        if result is not _OK:
            self.close()
            sent = self._config.setup[self._set_up_line].send
            raise UnreachableError(
                f"{self.description}: link.setup[{self._set_up_line}], {sent!r}, ended in {result.name.lower()}: "
                "check its reply, terminator and baudrate"
            )

    def close(self) -> None:
        """Close the port; a second call has no effect."""
        self._port.close()

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Set the voltage [V] and read; never raises, returns within the timeout."""
        result = self._exchange(voltage_V, clock.monotonic() + min(self._config.timeout_s, self.time_limit_s))
        self._exchange_generation = self._port.generation if result is _OK or result in ACKNOWLEDGED else ANY
        self.counts[result] += 1
        return result

    def poll(self) -> ExchangeResult:
        """Read without setting the voltage, with the same checks."""
        generation = self._port.generation
        deadline_s = clock.monotonic() + min(self._config.timeout_s, self.time_limit_s)
        result = self._ensure_verified(deadline_s)
        if self._port.generation != generation:
            self._plausibility.forget_heartbeat()
        if result is _OK:
            self._exchange_generation = self._port.generation
            result = self._measure_reading(deadline_s)
        self.counts[result] += 1
        return result

    def _exchange(self, voltage_V: float, deadline_s: float) -> ExchangeResult:
        template = self._set_voltage
        if template is None:
            return ExchangeResult.OUT_OF_RANGE
        line, written_V = template.fill(voltage_V)
        if not line:
            return ExchangeResult.OUT_OF_RANGE
        result = self._ensure_verified(deadline_s)
        if result is not _OK:
            return result
        if self._exchange_generation not in (ANY, self._port.generation):
            return ExchangeResult.DISCONNECTED  # the port was lost between two exchanges: the caller reads first
        self.written_V = written_V
        result, _ = self._exchange_line(line, self._acknowledge, deadline_s)
        return self._measure_reading(deadline_s) if result is _OK else result

    def _measure_reading(self, deadline_s: float) -> ExchangeResult:
        """Request a reading, check it and store its values."""
        if not self._measure:
            return _OK
        result, match = self._exchange_line(self._measure, self._pattern, deadline_s)
        if result is not _OK or match is None:
            return result
        result = self._fields.decode(match, self._plausibility.values, self._plausibility.counters)
        if result is _OK:
            result = self._plausibility.accept(-1)
        if result is not _OK:
            self.bad_exchange.keep(result, self._measure, self._port.buffer, self._received)
        return result

    def _ensure_set_up(self, deadline_s: float) -> ExchangeResult:
        """Reopen the port if necessary; after each opening send the lines of `setup`."""
        result = self._port.ensure_open()
        if result is not _OK or self._set_up_generation == self._port.generation:
            return result
        for number, (line, pattern) in enumerate(self._set_up):
            self._set_up_line = number
            result, _ = self._exchange_line(line, pattern, deadline_s)
            if result is not _OK:
                return result
        self._set_up_generation = self._port.generation
        return _OK

    def _ensure_verified(self, deadline_s: float) -> ExchangeResult:
        """Reopen the port if necessary; compare the identity after each opening, before a voltage is sent.

        The lines of `setup` come first, because they select the form of the replies. The watchdog is set again.
        UNVERIFIED: half of the time has passed; the exchange follows in the next call.
        """
        half_s = 0.5 * (clock.monotonic() + deadline_s)
        result = self._ensure_set_up(deadline_s)
        if result is not _OK or self._guard.verified == self._port.generation:
            return result
        result = self._guard.verify(self._port.generation, deadline_s)
        return ExchangeResult.UNVERIFIED if result is _OK and clock.monotonic() > half_s else result

    @property
    def supervised(self) -> int:
        """Number of calls of `supervise` that compare identity and watchdog once."""
        return self._guard.count

    def accept_foreign_command(self) -> None:
        """Nothing: a line device sends no number of a command."""

    def compare_command(self) -> ExchangeResult:
        """OK: a line device has one master, and `holds_command` is False."""
        return _OK

    def supervise(self, time_limit_s: float) -> ExchangeResult:
        """Compare the identity, or set the watchdog again, in turn."""
        if self._guard.verified != self._port.generation:
            return ExchangeResult.UNVERIFIED
        return self._guard.check_next(clock.monotonic() + min(self._config.timeout_s, time_limit_s))

    def _exchange_line(
        self, line: bytes, pattern: re.Pattern[bytes] | None, deadline_s: float
    ) -> tuple[ExchangeResult, re.Match[bytes] | None]:
        """Send a line; if it has a reply pattern, receive a line and match it."""
        port = self._port
        self._received = 0
        try:
            port.drain()
            port.send(line, deadline_s)
            if pattern is None:
                return _OK, None
            end = self._receive_line(deadline_s)
        except OSError:
            self.bad_exchange.keep(ExchangeResult.DISCONNECTED, line, port.buffer, self._received)
            port.close_lost()
            return ExchangeResult.DISCONNECTED, None
        match = pattern.fullmatch(port.view[:end]) if end >= 0 else None
        if match is not None:
            return _OK, match
        result = ExchangeResult.TIMEOUT if end < 0 else ExchangeResult.MALFORMED
        self.bad_exchange.keep(result, line, port.buffer, self._received)
        port.close_and_settle(self._config.timeout_s)
        return result, None

    def _receive_line(self, deadline_s: float) -> int:
        """Receive until the terminator; its index, or -1 if it is missing at the deadline."""
        port, terminator, received = self._port, self._terminator, 0
        while received < RECEIVE_BYTES:
            if not port.wait(deadline_s):
                break
            self._received = received = received + port.receive(received)
            end = port.buffer.find(terminator, 0, received)
            if end >= 0:
                port.stale_bytes += received - end - len(terminator)
                return end
        port.stale_bytes += received
        return -1

    def has(self, role: str) -> bool:
        """Whether a configured line or reply field has this role."""
        if role == "voltage_setpoint":
            return self._set_voltage is not None
        if role == WATCHDOG:
            return self._watchdog is not None
        return role in self._fields.roles

    def read_register(self, role: str) -> float:
        """Read one field of the reply to `measure`, or the watchdog time acknowledged by the device."""
        self._require(role)
        if role == WATCHDOG:
            return self._guard.watchdog_ms
        if role == "voltage_setpoint":
            return self.written_V
        result = self.poll()
        if result is not _OK:
            raise UnreachableError(
                f"{self.description}: reading {role} ended in {result.name.lower()}: check the patterns"
            )
        name = next(name for name in ROLES if ROLES[name] == role)
        return float(getattr(self.reading, name))

    def write_register(self, role: str, value: float) -> None:
        """Set the watchdog time; no other role can be written in set-up."""
        self._require(role)
        if role != WATCHDOG or self._watchdog is None:
            raise ConfigurationError(f"{self.description}: {role} cannot be written outside the tick")
        self._require_identity()
        line, written = self._watchdog.fill(value)
        match = self._exchange_or_raise(line, self._watchdog_reply, "link.watchdog")
        acknowledged = match is not None and WATCHDOG in match.re.groupindex
        try:
            self._guard.watchdog_ms = decimal(match[WATCHDOG]) if match is not None and acknowledged else written
        except (TypeError, ValueError):
            found = bytes(match[0][:60]) if match is not None else b""
            raise CheckFailedError(
                f"{self.description}: link.watchdog answered {shortened(found)}, must contain a time [ms]"
            ) from None

    def identify(self) -> None:
        """Compare the reply to `identity` with its pattern; raises IdentityError."""
        line, pattern = self._identity
        if not line:
            return
        try:
            self._exchange_or_raise(line, pattern, "link.identity")
        except CheckFailedError as error:
            raise IdentityError(f"{error}: another device, or another firmware") from error

    def _require_identity(self) -> None:
        """Compare the identity where the port was opened again: nothing is written to another device."""
        self._ensure_set_up(clock.monotonic() + max(SET_UP_TIMEOUT_S, self._config.timeout_s))
        if self._guard.verified != self._port.generation:
            self.identify()
            self._guard.verified = self._port.generation

    def _exchange_or_raise(self, line: bytes, pattern: re.Pattern[bytes] | None, where: str) -> re.Match[bytes] | None:
        """Exchange a line in set-up; raises UnreachableError, or CheckFailedError with the unexpected reply."""
        deadline_s = clock.monotonic() + max(SET_UP_TIMEOUT_S, self._config.timeout_s)
        result = self._ensure_set_up(deadline_s)
        if result is not _OK:
            raise UnreachableError(f"{self.description}: {result.name.lower()}: is the device on?")
        result, match = self._exchange_line(line, pattern, deadline_s)
        if result is ExchangeResult.MALFORMED and pattern is not None:
            found = bytes(self._port.view[:60]).split(self._terminator)[0]
            raise CheckFailedError(
                f"{self.description}: {where} answered {shortened(found)}, expected {shortened(pattern.pattern)}"
            )
        if result is not _OK:
            raise UnreachableError(
                f"{self.description}: {where}: {result.name.lower()}: check cable, baudrate, terminator"
            )
        return match

    def _require(self, role: str) -> None:
        if not self.has(role):
            raise ConfigurationError(f"{self.description}: no configured line has the role '{role}'")
