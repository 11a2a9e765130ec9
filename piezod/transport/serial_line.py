r"""A device that speaks lines of ASCII over a serial port: one line sets the voltage, another asks for a reading.

-> SVA A 10.000\n
-> VOL? A\n
<- 9.998\n
"""

import re
from math import inf, isfinite, nan
from time import monotonic

from piezod.config.checked import shortened
from piezod.config.link import LineCommand, SerialLineLink
from piezod.errors import CheckFailedError, ConfigurationError, IdentityError, UnreachableError
from piezod.transport.line_template import ROLES, LineTemplate, compile_reply, plain_line
from piezod.transport.link import ExchangeResult, Reading
from piezod.transport.serial_port import RECEIVE_BYTES, SerialPort
from piezod.transport.tick_values import COUNTERS, QUANTITIES, Plausibility

SET_UP_TIMEOUT_S = 0.5  # outside the tick a device may take its time
WATCHDOG = "watchdog_ms"

_OK = ExchangeResult.OK


class SerialLineDevice:
    """Sets a voltage by one line and reads by another; both within the one timeout.

    Parameters
    ----------
    config
        The `link` section.

    Raises
    ------
    ConfigurationError
        A template or a pattern that cannot be used.
    """

    __slots__ = (
        "_acknowledge",
        "_config",
        "_counters",
        "_identity",
        "_measure",
        "_pattern",
        "_plausibility",
        "_port",
        "_quantities",
        "_set_up",
        "_set_up_generation",
        "_set_voltage",
        "_terminator",
        "_watchdog",
        "_watchdog_ms",
        "_watchdog_reply",
        "counts",
        "hint",
        "patience_s",
        "reading",
        "written_V",
    )
    last_exception = 0

    def __init__(self, config: SerialLineLink) -> None:
        self._config, self._port = config, SerialPort(config)
        self._terminator = config.terminator.encode("ascii")
        self._set_voltage, self._acknowledge = self._template(config.set_voltage, "voltage_V", "set_voltage")
        self._watchdog, self._watchdog_reply = self._template(config.watchdog, WATCHDOG, "watchdog")
        self._measure, self._pattern = self._query(config.measure, "measure", ROLES)
        self._identity = self._query(config.identity, "identity")
        self._set_up = [self._query(command, "setup") for command in config.setup]
        names = tuple(self._pattern.groupindex) if self._pattern is not None else ()
        self._quantities = tuple((name, QUANTITIES[ROLES[name]]) for name in names if ROLES[name] in QUANTITIES)
        self._counters = tuple((name, COUNTERS[ROLES[name]]) for name in names if ROLES[name] in COUNTERS)
        self._plausibility = Plausibility(
            frozenset(ROLES[name] for name in names) - {"command_echo"}, config.heartbeat_within_s
        )
        self.reading: Reading = self._plausibility.reading
        self._set_up_generation = -1
        self._watchdog_ms = nan
        self.counts = [0] * len(ExchangeResult)
        self.written_V = nan
        self.patience_s = inf
        self.hint = ""

    def _template(
        self, command: LineCommand | None, field: str, key: str
    ) -> tuple[LineTemplate | None, re.Pattern[bytes] | None]:
        if command is None:
            return None, None
        template = LineTemplate(command.send, field, self._config.terminator, f"link.{key}.send")
        return template, compile_reply(command, f"link.{key}", {field: 0})

    def _query(
        self, command: LineCommand | None, key: str, groups: dict[str, str] | None = None
    ) -> tuple[bytes, re.Pattern[bytes] | None]:
        if command is None:
            return b"", None
        where = f"link.{key}"
        return plain_line(command, self._config.terminator, where), compile_reply(command, where, groups)

    @property
    def description(self) -> str:
        """Kind and address, for people."""
        return f"serial_line {self._config.port} {self._config.baudrate} baud"

    @property
    def stale_bytes(self) -> int:
        """Bytes that arrived unasked or too late, and were discarded."""
        return self._port.stale_bytes

    def open(self) -> None:
        """Open and lock the port, send the lines of `setup`; raises UnreachableError or BusyError."""
        self._port.open()
        self._plausibility.forget()
        result = self._ready(monotonic() + max(SET_UP_TIMEOUT_S, self._config.timeout_s))
        if result is not _OK:
            self.close()
            raise UnreachableError(
                f"{self.description}: a line of setup ended in {result.name.lower()}: check terminator and baudrate"
            )

    def close(self) -> None:
        """Let go of the port; may be called twice."""
        self._port.close()

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Set the voltage [V] and read; never raises, lasts at most the link's timeout."""
        result = self._exchange(voltage_V, monotonic() + min(self._config.timeout_s, self.patience_s))
        self.counts[result] += 1
        return result

    def poll(self) -> ExchangeResult:
        """Read without setting anything; the same checks."""
        generation = self._port.generation
        deadline_s = monotonic() + min(self._config.timeout_s, self.patience_s)
        result = self._ready(deadline_s)
        if self._port.generation != generation:
            self._plausibility.forget()
        if result is _OK:
            result = self._look(deadline_s)
        self.counts[result] += 1
        return result

    def _exchange(self, voltage_V: float, deadline_s: float) -> ExchangeResult:
        template = self._set_voltage
        if template is None:
            return ExchangeResult.OUT_OF_RANGE
        line, written_V = template.fill(voltage_V)
        if not line:
            return ExchangeResult.OUT_OF_RANGE
        result = self._ready(deadline_s)
        if result is not _OK:
            return result
        self.written_V = written_V
        result, _ = self._converse(line, self._acknowledge, deadline_s)
        return self._look(deadline_s) if result is _OK else result

    def _look(self, deadline_s: float) -> ExchangeResult:
        """Ask for a reading, check it, believe it."""
        if not self._measure:
            return _OK
        result, match = self._converse(self._measure, self._pattern, deadline_s)
        if result is not _OK or match is None:
            return result
        values, counters = self._plausibility.values, self._plausibility.counters
        try:
            for name, slot in self._quantities:
                value = _decimal(match[name])
                if not isfinite(value):
                    return ExchangeResult.NOT_FINITE
                values[slot] = value
            for name, slot in self._counters:
                counters[slot] = _whole(match[name])
        except (TypeError, ValueError):
            return ExchangeResult.MALFORMED
        return self._plausibility.accept(-1)

    def _ready(self, deadline_s: float) -> ExchangeResult:
        """Open the port again if it must be; a device that was gone is set up again."""
        result = self._port.ready()
        if result is not _OK or self._set_up_generation == self._port.generation:
            return result
        for line, pattern in self._set_up:
            result, _ = self._converse(line, pattern, deadline_s)
            if result is not _OK:
                return result
        self._set_up_generation = self._port.generation
        return _OK

    def _converse(
        self, line: bytes, pattern: re.Pattern[bytes] | None, deadline_s: float
    ) -> tuple[ExchangeResult, re.Match[bytes] | None]:
        """Send a line; receive one and match it if there is a pattern."""
        port = self._port
        try:
            port.drain()
            port.send(line, deadline_s)
            if pattern is None:
                return _OK, None
            end = self._receive_line(deadline_s)
        except OSError:
            port.vanished()
            return ExchangeResult.DISCONNECTED, None
        match = pattern.fullmatch(port.view[:end]) if end >= 0 else None
        if match is not None:
            return _OK, match
        port.distrust(self._config.timeout_s)
        return (ExchangeResult.TIMEOUT if end < 0 else ExchangeResult.MALFORMED), None

    def _receive_line(self, deadline_s: float) -> int:
        """Receive until the terminator; its place, or -1 when it did not come until the deadline."""
        port, terminator, received = self._port, self._terminator, 0
        while received < RECEIVE_BYTES:
            if not port.wait(deadline_s):
                break
            received += port.receive(received)
            end = port.buffer.find(terminator, 0, received)
            if end >= 0:
                port.stale_bytes += received - end - len(terminator)
                return end
        port.stale_bytes += received
        return -1

    def has(self, role: str) -> bool:
        """Whether a line of the configuration carries this role."""
        if role == "voltage_setpoint":
            return self._set_voltage is not None
        if role == WATCHDOG:
            return self._watchdog is not None
        return any(ROLES[name] == role for name, _ in (*self._quantities, *self._counters))

    def read_register(self, role: str) -> float:
        """Read one field of the reading, or the watchdog time that the device acknowledged."""
        self._require(role)
        if role == WATCHDOG:
            return self._watchdog_ms
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
        """Send the line of the watchdog; nothing else can be written outside the tick."""
        self._require(role)
        if role != WATCHDOG or self._watchdog is None:
            raise ConfigurationError(f"{self.description}: {role} cannot be written outside the tick")
        line, written = self._watchdog.fill(value)
        match = self._ask(line, self._watchdog_reply, "link.watchdog")
        told = match is not None and WATCHDOG in match.re.groupindex
        try:
            self._watchdog_ms = _decimal(match[WATCHDOG]) if match is not None and told else written
        except (TypeError, ValueError):
            found = bytes(match[0][:60]) if match is not None else b""
            raise CheckFailedError(
                f"{self.description}: link.watchdog answered {shortened(found)}, which names no time"
            ) from None

    def identify(self) -> None:
        """Compare the answer to the identity's line with its pattern; raises IdentityError."""
        line, pattern = self._identity
        if not line:
            return
        try:
            self._ask(line, pattern, "link.identity")
        except CheckFailedError as error:
            raise IdentityError(f"{error}: another device, or another firmware") from error

    def _ask(self, line: bytes, pattern: re.Pattern[bytes] | None, where: str) -> re.Match[bytes] | None:
        """Converse outside the tick; raises UnreachableError, or CheckFailedError naming what came instead."""
        deadline_s = monotonic() + max(SET_UP_TIMEOUT_S, self._config.timeout_s)
        result = self._ready(deadline_s)
        if result is not _OK:
            raise UnreachableError(f"{self.description}: {result.name.lower()}: is the device on?")
        result, match = self._converse(line, pattern, deadline_s)
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
            raise ConfigurationError(f"{self.description}: no line of the configuration carries '{role}'")


def _decimal(text: bytes) -> float:
    """The number that a field says; raises ValueError, also for the underscores that Python would skip."""
    if b"_" in text:
        raise ValueError
    return float(text)


def _whole(text: bytes) -> int:
    """The whole number that a field says; raises ValueError, as `_decimal`."""
    if b"_" in text:
        raise ValueError
    return int(text)
