"""Link to one Modbus device: the blocks of the tick, and single registers for set-up."""

from math import inf
from typing import Any, NoReturn

from piezod.config.link import READ_WRITE, ModbusRtuLink, ModbusTcpLink, Register, Registers, RtuOverTcpLink
from piezod.errors import BusyError, ConfigurationError, TemporaryError, UnreachableError
from piezod.runtime import clock
from piezod.transport.frames import Request, read_request, read_write_request, write_request
from piezod.transport.held_command import HeldNumber, HeldSetPoint
from piezod.transport.identity import Expectation, check_register
from piezod.transport.link import ACKNOWLEDGED, ANY, ExchangeResult, Reading
from piezod.transport.register_guard import IDENTITY_ROLES, RegisterGuard
from piezod.transport.registers import RegisterCodec
from piezod.transport.tick_values import COUNTERS, Plausibility, ReadBlock, SetPoint
from piezod.transport.wire import Wire

SET_UP_TIMEOUT_S = 0.5  # shortest time limit of a set-up exchange
SET_UP_RETRY_S = 0.01  # time between two attempts to reconnect
IDENTIFY_TRIES = 3  # largest number of connections on which the identity is read
TEMPORARY_EXCEPTIONS = {4: "device failure", 5: "acknowledge", 6: "busy", 10: "gateway path", 11: "gateway target"}
PERMANENT_EXCEPTIONS = {1: "illegal function", 2: "illegal address", 3: "illegal value"}

_OK = ExchangeResult.OK


class ModbusLink:
    """Writes the set point, reads the block and checks every reply.

    Function 23 writes and reads in one transaction. Functions 16 or 6 and 3 or 4 need two transactions in one timeout.

    Parameters
    ----------
    config
        The `link` section.
    wire
        Wire that transmits the frames.

    Raises
    ------
    ConfigurationError
        The register map does not allow an exchange in a tick.
    """

    __slots__ = (
        "_block",
        "_exchange_generation",
        "_guard",
        "_held",
        "_number",
        "_plausibility",
        "_poll_generation",
        "_read",
        "_registers",
        "_set_point",
        "_timeout_s",
        "_unit",
        "_wire",
        "_write",
        "_written_generation",
        "counts",
        "reading",
        "time_limit_s",
        "written_V",
    )
    output_confirmed = False  # one device: the result of the exchange says it

    def __init__(self, config: ModbusTcpLink | ModbusRtuLink | RtuOverTcpLink, wire: Wire) -> None:
        self._wire, self._unit, self._timeout_s = wire, config.unit_id, config.timeout_s
        self._registers: Registers = config.registers
        self._guard = RegisterGuard(wire, config.unit_id, config.registers)
        writes, reads = config.registers.tick_writes(), config.registers.tick_reads()
        self._plausibility = Plausibility(frozenset(reads), config.heartbeat_within_s)
        self.reading: Reading = self._plausibility.reading
        self._set_point = set_point = SetPoint(writes) if "voltage_setpoint" in writes else None
        self._block = ReadBlock(reads) if reads else None
        self._read = self._read_template(reads)
        self._write = self._write_template(writes)
        self._held: HeldSetPoint | HeldNumber | None = None
        if self._write is not None and config.setpoint_readable:
            self._held = HeldSetPoint(wire, config.unit_id, writes, self._write)
        elif set_point is not None and set_point.has_sequence and "command_echo" in reads:
            self._held = HeldNumber(wire, config.unit_id, reads["command_echo"])
        self._written_generation = -1
        # connections of the last good exchange and of the last poll
        self._exchange_generation = self._poll_generation = ANY
        self._number = 0  # of the command that the device holds
        self.time_limit_s = inf
        self.counts = [0] * len(ExchangeResult)
        self.written_V = float("nan")

    def _read_template(self, reads: dict[str, Register]) -> Request | None:
        """Request for `poll`: function 3 replaces function 23, which would also write."""
        if self._block is None:
            return None
        function = 4 if next(iter(reads.values())).function == 4 else 3
        return read_request(self._wire.framing, self._unit, function, self._block.first, self._block.count)

    def _write_template(self, writes: dict[str, Register]) -> Request | None:
        if self._set_point is None:
            return None
        first, words = next(iter(writes.values())), sum(register.words for register in writes.values())
        if first.function == READ_WRITE:
            if self._block is None:
                raise ConfigurationError(
                    "registers.voltage_setpoint.function is 23, but no register is read: use 16 or 6"
                )
            return read_write_request(
                self._wire.framing, self._unit, self._block.first, self._block.count, first.address, words
            )
        if first.function == 6 and words > 1:
            raise ConfigurationError(
                f"registers.voltage_setpoint.function 6 writes one register, the tick writes {words}: use 16"
            )
        return write_request(self._wire.framing, self._unit, first.function, first.address, words)

    @property
    def description(self) -> str:
        """Kind and address of the link, for messages."""
        return self._wire.description

    @property
    def last_exception(self) -> int:
        """Code of the last Modbus exception; 0: none."""
        return self._wire.exception_code

    @property
    def stale_bytes(self) -> int:
        """Number of discarded bytes: unrequested or too late."""
        return self._wire.stale_bytes

    def keep_bad_exchange_in(self, cells: Any, link: int = 0) -> None:  # noqa: ANN401  # any object with the buffer protocol
        """Write the bytes of failed exchanges into this memory from now on."""
        self._wire.bad_exchange.use(cells, link)

    @property
    def hint(self) -> str:
        """Probable cause of the last failures; empty: unknown."""
        return self._wire.hint

    def open(self) -> None:
        """Connect; raises UnreachableError or BusyError."""
        self._wire.open()
        self._exchange_generation = self._poll_generation = self._wire.generation
        self._plausibility.forget_heartbeat()

    def close(self) -> None:
        """Disconnect; a second call has no effect."""
        self._wire.close()

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] and read the block; never raises, returns within the timeout."""
        result = self._exchange(voltage_V, clock.monotonic() + min(self._timeout_s, self.time_limit_s))
        self._exchange_generation = self._wire.generation if result is _OK or result in ACKNOWLEDGED else ANY
        self.counts[result] += 1
        return result

    def poll(self) -> ExchangeResult:
        """Read the block without writing, with the same checks; after a reconnection accept any heartbeat."""
        result = self._poll(clock.monotonic() + min(self._timeout_s, self.time_limit_s))
        self.counts[result] += 1
        return result

    def accept_foreign_command(self) -> None:
        """Compare with the command that the device holds now, of whatever program, until the next one is sent."""
        self._number = self._plausibility.counters[COUNTERS["command_echo"]]

    def _exchange(self, voltage_V: float, deadline_s: float) -> ExchangeResult:
        write, set_point = self._write, self._set_point
        if write is None or set_point is None:
            return ExchangeResult.OUT_OF_RANGE
        result = self._write_set_point(write, set_point, voltage_V, deadline_s)
        if result is not _OK or self._block is None:
            return result
        echo = set_point.sequence if set_point.has_sequence else -1
        return self._accept_reply(write, echo) if write.reads else self._read_block(deadline_s, echo)

    def _write_set_point(
        self, write: Request, set_point: SetPoint, voltage_V: float, deadline_s: float
    ) -> ExchangeResult:
        """Send the set point; if the voltage cannot be encoded, send nothing.

        Nor is anything sent where the connection was lost between two exchanges. The device may have restarted, and no
        exchange has reported it: this one does, and the caller reads the device before it writes again.
        """
        wire = self._wire
        written_V = set_point.encode_into(write, voltage_V)
        if written_V != written_V:  # noqa: PLR0124 - nan
            return ExchangeResult.OUT_OF_RANGE
        result = self._ensure_verified(deadline_s)
        if result is not _OK:
            return result
        if self._exchange_generation not in (ANY, wire.generation):
            return ExchangeResult.DISCONNECTED
        self.written_V = written_V
        result = wire.transact(write, deadline_s)
        self._number = set_point.sequence
        refused = result is ExchangeResult.DEVICE_EXCEPTION
        self._written_generation = -1 if refused else wire.generation
        return result

    def _poll(self, deadline_s: float) -> ExchangeResult:
        wire, set_point = self._wire, self._set_point
        result = self._ensure_verified(deadline_s)
        if wire.generation != self._poll_generation:
            self._poll_generation = wire.generation
            self._plausibility.forget_heartbeat()
        if result is not _OK:
            return result
        self._exchange_generation = wire.generation
        if set_point is not None and set_point.has_sequence and self._written_generation == wire.generation:
            return self._read_block(deadline_s, self._number)
        return self._read_block(deadline_s, -1)

    def _ensure_verified(self, deadline_s: float) -> ExchangeResult:
        """Reconnect if necessary; compare the identity on every new connection, before anything is written."""
        result = self._wire.ensure_open(deadline_s)
        if result is not _OK or self._guard.is_verified():
            return result
        return self._guard.verify(deadline_s)

    @property
    def supervised(self) -> int:
        """Number of calls of `supervise` that compare every register once."""
        return self._guard.count

    def supervise(self, time_limit_s: float) -> ExchangeResult:
        """Read the next register that must not change; a setting that changed is written again."""
        return self._guard.check_next(clock.monotonic() + min(self._timeout_s, time_limit_s))

    @property
    def holds_command(self) -> bool:
        """Whether the last command can be read from the device."""
        return self._held is not None

    def compare_command(self) -> ExchangeResult:
        """Compare the command that the device holds with the last one written; a refused one is unknown."""
        held, wire = self._held, self._wire
        if held is None or self._written_generation != wire.generation:
            return _OK
        result = wire.transact(held.request, clock.monotonic() + self._timeout_s)
        if result is not _OK:
            return result
        result = held.compare(wire, self._number)
        if result is not _OK:
            wire.bad_exchange.keep(result, held.request.frame, wire.payload, held.request.reply_size)
        return result

    def _read_block(self, deadline_s: float, echo: int) -> ExchangeResult:
        """Read the block, if the register map has one."""
        read = self._read
        if read is None:
            return _OK
        result = self._wire.transact(read, deadline_s)
        return self._accept_reply(read, echo) if result is _OK else result

    def _accept_reply(self, request: Request, echo: int) -> ExchangeResult:
        """Decode and check the valid reply to `request`, and store its values."""
        block, plausibility = self._block, self._plausibility
        assert block is not None
        result = block.decode(self._wire.payload, request.payload_at, plausibility.values, plausibility.counters)
        if result is _OK:
            result = plausibility.accept(echo)
        if result is not _OK:
            self._wire.bad_exchange.keep(result, request.frame, self._wire.payload, request.reply_size)
        return result

    def has(self, role: str) -> bool:
        """Whether the register map has this role."""
        return isinstance(getattr(self._registers, role, None), Register)

    def read_register(self, role: str) -> float:
        """Read one register; for set-up, not in a tick."""
        register = self._register(role)
        return RegisterCodec(register).unpack_from(self._read_bytes(role, register), 0)

    def write_register(self, role: str, value: float) -> None:
        """Write one register; for set-up, not in a tick."""
        register = self._register(role)
        if role in Registers.TICK_WRITES:
            raise ConfigurationError(f"registers.{role} is written only in the tick, after all limits")
        if register.function in (3, 4):
            raise ConfigurationError(f"registers.{role}.function is {register.function}, must be 16 or 6 to be written")
        codec = RegisterCodec(register)
        codec.check_encodable(value, value, f"registers.{role}")
        function = 6 if register.function == 6 else 16
        request = write_request(self._wire.framing, self._unit, function, register.address, register.words)
        codec.pack_into(request.frame, request.values_at, value)
        if request.mirrors_values:
            request.mirror_values()
        self._transact_or_raise(request, role, register, to_verified=True)
        self._guard.note_setting(role, register, request)

    def identify(self) -> None:
        """Compare identity, version and byte order, as far as configured; raises IdentityError."""
        for _ in range(IDENTIFY_TRIES):
            generation = self._wire.generation
            for role in IDENTITY_ROLES:
                expected = getattr(self._registers, role)
                if expected is not None:
                    check_register(Expectation(role, expected, self.description), self._read_bytes(role, expected))
            if isinstance(self._held, HeldSetPoint):  # a device that refuses it does so before a voltage is written
                self._transact_or_raise(self._held.request, "voltage_setpoint", self._register("voltage_setpoint"))
            if generation == self._wire.generation:  # all values are of one connection
                self._guard.mark_verified(generation)
                return

    def _register(self, role: str) -> Register:
        register = getattr(self._registers, role, None)
        if not isinstance(register, Register):
            raise ConfigurationError(f"link.registers.{role} is missing: {self.description} has no such register")
        return register

    def _read_bytes(self, role: str, register: Register) -> bytes:
        function = 4 if register.function == 4 else 3
        request = read_request(self._wire.framing, self._unit, function, register.address, register.words)
        self._transact_or_raise(request, role, register)
        return bytes(self._wire.payload[request.payload_at : request.payload_at + 2 * register.words])

    def _transact_or_raise(self, request: Request, role: str, register: Register, *, to_verified: bool = False) -> None:
        """Exchange in set-up; with `to_verified`, compare the identity first where the connection is new."""
        wire = self._wire
        deadline_s = clock.monotonic() + max(SET_UP_TIMEOUT_S, self._timeout_s)
        while (result := wire.ensure_open(deadline_s)) is not _OK and clock.monotonic() < deadline_s:
            clock.sleep(SET_UP_RETRY_S)
        if result is _OK:
            if to_verified and not self._guard.is_verified():
                self.identify()
            result = wire.transact(request, deadline_s)
        if result is not _OK:
            self._raise_error(result, f"{self.description}: registers.{role} at address {register.address}")

    def _raise_error(self, result: ExchangeResult, where: str) -> NoReturn:
        """Raise the error for a failed set-up exchange, with cause and remedy."""
        code = self._wire.exception_code
        if result is ExchangeResult.DEVICE_EXCEPTION and code in PERMANENT_EXCEPTIONS:
            raise ConfigurationError(
                f"{where}: exception {code}, {PERMANENT_EXCEPTIONS[code]}: check address and function"
            )
        if result is ExchangeResult.DEVICE_EXCEPTION:
            name = TEMPORARY_EXCEPTIONS.get(code, "unknown")
            raise TemporaryError(f"{where}: exception {code}, {name}: try again")
        if result is ExchangeResult.DISCONNECTED and self._wire.framing == "tcp" and self._wire.hint:
            raise ConfigurationError(f"{where}: {self._wire.hint}")
        if result is ExchangeResult.DISCONNECTED and self._wire.framing == "tcp" and not self._wire.answered:
            raise BusyError(f"{where}: connection closed without a reply: another client may hold the device")
        if result in (ExchangeResult.TIMEOUT, ExchangeResult.DISCONNECTED):
            advice = self._wire.hint or "check unit_id, cable, and whether another client holds it"
            raise UnreachableError(f"{where}: {result.name.lower()}: {advice}")
        what = "baudrate and parity" if result is ExchangeResult.BAD_CRC else "unit_id, address and function"
        advice = f": {self._wire.hint}" if self._wire.hint else f": check {what}"
        raise ConfigurationError(f"{where}: the reply is invalid, {result.name.lower()}{advice}")
