"""The `link` section: connection to amplifier and load cell, and their register maps."""

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section
from piezod.config.host_name import HostName, address_of

WordOrder = Literal["AB", "BA", "ABCD", "CDAB", "BADC", "DCBA"]
RegisterType = Literal["int16", "uint16", "int32", "float32"]

READ_WRITE = 23  # function code 0x17: one exchange writes the set point and reads the block
READ_FUNCTIONS = (READ_WRITE, 3, 4)
WRITE_FUNCTIONS = (READ_WRITE, 16, 6)


class Register(Section):
    """One quantity in the register map: `value = raw * scale + offset`, in `unit`."""

    address: Annotated[int, Field(ge=0, le=65535)]
    function: Literal[23, 3, 4, 6, 16] = 23
    type: RegisterType = "float32"
    order: WordOrder | None = None
    scale: float = 1.0
    offset: float = 0.0
    unit: str = "1"
    low: float | None = None
    high: float | None = None

    @property
    def words(self) -> int:
        """Number of 16-bit registers of the value."""
        return 1 if self.type in ("int16", "uint16") else 2

    @property
    def byte_order(self) -> str:
        """Order of the bytes on the wire; default is big-endian (AB, ABCD)."""
        return self.order or ("AB" if self.words == 1 else "ABCD")

    @model_validator(mode="after")
    def _order_fits_type(self) -> Self:
        if self.scale == 0.0:
            raise ValueError("scale is 0, must be different from 0")
        if len(self.byte_order) != 2 * self.words:
            expected = "AB or BA" if self.words == 1 else "ABCD, CDAB, BADC or DCBA"
            raise ValueError(f"order is {self.order}, must be {expected} for {self.type}")
        if self.function == 6 and self.words != 1:
            raise ValueError(f"function 6 writes one register, {self.type} takes two: use 16")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low is {self.low:g}, must be below high, {self.high:g}")
        return self


class ExpectedRegister(Register):
    """A register with a known value; a different value indicates another device, map or byte order."""

    expect: float


ROLE_UNITS = {
    "voltage_setpoint": "V",
    "voltage_readback": "V",
    "force": "N",
    "reference": "N",
    "temperature": "degC",
    "watchdog_ms": "ms",
    "virtual_tick_us": "us",
}


class Registers(Section):
    """The register map of a device: one key per role.

    Each tick writes `voltage_setpoint` and `command_sequence`. It reads `force` to `reference_counter` as one block.
    The watchdog is written before arming. It is read again while driving, as are identity, map version and order check.
    These three are also read at every connection.
    """

    voltage_setpoint: Register | None = None
    command_sequence: Register | None = None

    force: Register | None = None
    voltage_readback: Register | None = None
    heartbeat: Register | None = None
    command_echo: Register | None = None
    status: Register | None = None
    temperature: Register | None = None
    reference: Register | None = None
    reference_counter: Register | None = None

    identity: ExpectedRegister | None = None
    map_version: ExpectedRegister | None = None
    order_check: ExpectedRegister | None = None
    watchdog_ms: Register | None = None
    virtual_time: Register | None = None
    virtual_tick_us: Register | None = None

    TICK_WRITES: ClassVar[tuple[str, ...]] = ("voltage_setpoint", "command_sequence")
    _TICK_READS = (
        *("force", "voltage_readback", "heartbeat", "command_echo"),
        *("status", "temperature", "reference", "reference_counter"),
    )

    def tick_writes(self) -> dict[str, Register]:
        """Registers written in each tick, by role, in ascending order of address."""
        return self._present(self.TICK_WRITES)

    def tick_reads(self) -> dict[str, Register]:
        """Registers read in each tick, by role, in ascending order of address."""
        return self._present(self._TICK_READS)

    def _present(self, names: tuple[str, ...]) -> dict[str, Register]:
        registers = {name: register for name in names if (register := getattr(self, name)) is not None}
        return dict(sorted(registers.items(), key=lambda item: item[1].address))

    @model_validator(mode="after")
    def _units_are_those_of_the_role(self) -> Self:
        for name, unit in ROLE_UNITS.items():
            register = getattr(self, name)
            if register is not None and register.unit != unit:
                raise ValueError(f"{name}.unit is '{register.unit}', must be '{unit}'; convert with scale and offset")
        return self

    @model_validator(mode="after")
    def _blocks_fit_a_request(self) -> Self:
        _check_block("tick reads", self.tick_reads(), READ_FUNCTIONS, 125, contiguous=False)
        _check_block("tick writes", self.tick_writes(), WRITE_FUNCTIONS, 121, contiguous=True)
        writes, reads = self.tick_writes(), self.tick_reads()
        both = {register.function for register in (*writes.values(), *reads.values())}
        if READ_WRITE in both and both != {READ_WRITE}:
            raise ValueError("function 23 writes and reads in one exchange: use it for all tick registers or for none")
        return self


def _check_block(
    what: str, registers: dict[str, Register], functions: tuple[int, ...], most: int, *, contiguous: bool
) -> None:
    """Refuse registers that do not fit one Modbus request."""
    if not registers:
        return
    end: int | None = None
    for name, register in registers.items():
        if register.function not in functions:
            allowed = ", ".join(str(function) for function in functions)
            raise ValueError(f"{name}.function is {register.function}, must be one of {allowed}")
        if end is not None and (register.address < end or (contiguous and register.address > end)):
            raise ValueError(f"{name}.address is {register.address}, must be {'' if contiguous else 'at least '}{end}")
        end = register.address + register.words
    if len({register.function for register in registers.values()}) > 1:
        raise ValueError(f"the {what} have different functions, must have the same: one request carries them")
    first = next(iter(registers.values()))
    if end is not None and end - first.address > most:
        raise ValueError(f"the {what} span {end - first.address} registers, must be at most {most} for one request")


class _ModbusLink(Section):
    """Keys of both Modbus transports."""

    unit_id: Annotated[int, Field(ge=0, le=255)] = 1
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 0.02
    heartbeat_within_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    setpoint_readable: bool = False
    registers: Registers

    def has_role(self, role: str) -> bool:
        """Whether the register map has this role."""
        return getattr(self.registers, role, None) is not None


PLAIN_PORT, SECURE_PORT = 502, 802  # IANA service names mbap and mbap-s


class TlsConfig(Section):
    """Files for Modbus/TCP Security, in which both sides present a certificate.

    `ca` signs the certificate of the device; `certificate` and `key` belong to piezod.
    Paths are absolute, or begin with $CREDENTIALS_DIRECTORY/, the folder of systemd's LoadCredential=.
    """

    ca: Annotated[str, Field(pattern=r"^(/|\$CREDENTIALS_DIRECTORY/).+")]
    certificate: Annotated[str, Field(pattern=r"^(/|\$CREDENTIALS_DIRECTORY/).+")]
    key: Annotated[str, Field(pattern=r"^(/|\$CREDENTIALS_DIRECTORY/).+")]
    server_name: HostName | None = None


class ModbusTcpLink(_ModbusLink):
    """Modbus over TCP; with `tls`, the connection is always encrypted and authenticated."""

    kind: Literal["modbus_tcp"]
    host: HostName
    port: Annotated[int, Field(ge=1, le=65535)] = PLAIN_PORT
    connect_timeout_s: Annotated[float, Field(gt=0, le=10)] = 1.0
    tls: TlsConfig | None = None
    allow_plaintext_remote: bool = False

    @model_validator(mode="before")
    @classmethod
    def _port_follows_tls(cls, content: Any) -> Any:  # noqa: ANN401  # unchecked content of the file
        if isinstance(content, dict) and content.get("tls") is not None and "port" not in content:
            return content | {"port": SECURE_PORT}
        return content

    @model_validator(mode="after")
    def _plain_modbus_needs_a_local_host(self) -> Self:
        if message := self.plaintext_refusal(self.host):
            raise ValueError(message)
        return self

    def plaintext_refusal(self, host: str) -> str:
        """Message why plain Modbus must not use this address; empty: it may, or `host` is an unresolved name."""
        allowed = self.tls is not None or self.allow_plaintext_remote
        remedy = "set tls, or set allow_plaintext_remote: true"
        return "" if allowed or not _is_routable(host) else _plaintext_refusal(self.host, host, remedy)


def _is_routable(address: str) -> bool:
    """Whether an address is one of the public network; False for a name."""
    parsed = address_of(address)
    return parsed is not None and parsed.is_global


def _plaintext_refusal(name: str, address: str, remedy: str) -> str:
    return (
        f"host {name} is the routable address {address}: everybody on the route can write the voltage by plain "
        f"Modbus; {remedy}"
    )


class _SerialPort(Section):
    """Parameters of a serial port."""

    port: Annotated[str, Field(min_length=1)]
    baudrate: Annotated[int, Field(ge=300, le=12_000_000)] = 115200
    bytesize: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "N"
    stopbits: Literal[1, 2] = 1

    @property
    def bits_per_character(self) -> int:
        """Number of bits per character: start, data, parity and stop bits."""
        return 1 + self.bytesize + (self.parity != "N") + self.stopbits


class ModbusRtuLink(_ModbusLink, _SerialPort):
    """Modbus RTU over a serial port."""

    kind: Literal["modbus_rtu"]
    unit_id: Annotated[int, Field(ge=1, le=247)] = 1
    silent_interval: Literal["characters", "fixed"] = "characters"


class RtuOverTcpLink(_ModbusLink):
    """Modbus RTU frames over TCP: a serial gateway passes each byte on.

    `baudrate` is that of the line behind the gateway. It limits the rate of the ticks, and determines how long a late
    reply is possible.
    """

    kind: Literal["rtu_over_tcp"]
    unit_id: Annotated[int, Field(ge=1, le=247)] = 1
    host: HostName
    port: Annotated[int, Field(ge=1, le=65535)]
    connect_timeout_s: Annotated[float, Field(gt=0, le=10)] = 1.0
    baudrate: Annotated[int, Field(ge=300, le=12_000_000)] = 115200
    silent_interval: Literal["characters", "fixed"] = "characters"
    allow_plaintext_remote: bool = False
    tls: ClassVar[None] = None
    bits_per_character: ClassVar[int] = 11
    """Start bit, eight data bits, parity and stop bit, or two stop bits: MODBUS over Serial Line 1.02, 2.5.1."""

    @model_validator(mode="after")
    def _plain_modbus_needs_a_local_host(self) -> Self:
        if message := self.plaintext_refusal(self.host):
            raise ValueError(message)
        return self

    def plaintext_refusal(self, host: str) -> str:
        """Message why plain Modbus must not use this address; empty: it may, or `host` is an unresolved name."""
        if self.allow_plaintext_remote or not _is_routable(host):
            return ""
        return _plaintext_refusal(self.host, host, "set allow_plaintext_remote: true")


class LineCommand(Section):
    """A line to send, and a regular expression with named groups that must match the whole reply."""

    send: Annotated[str, Field(min_length=1, max_length=200)]
    reply: str | None = None


class SerialLineLink(_SerialPort):
    """A device with an ASCII line protocol, such as `SVA A 10.0` or `XV10.0`."""

    kind: Literal["serial_line"]
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 0.05
    heartbeat_within_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    terminator: Annotated[str, Field(min_length=1, max_length=4)] = "\n"
    set_voltage: LineCommand | None = None
    measure: LineCommand | None = None
    identity: LineCommand | None = None
    setup: Annotated[tuple[LineCommand, ...], Field(strict=False)] = ()
    watchdog: LineCommand | None = None

    def has_role(self, role: str) -> bool:
        """Whether a line has this role; the reply to `identity` covers both device and firmware version."""
        lines = {
            "voltage_setpoint": self.set_voltage,
            "watchdog_ms": self.watchdog,
            "identity": self.identity,
            "map_version": self.identity,
        }
        if role in lines:
            return lines[role] is not None
        group = {"force": "force_N", "voltage_readback": "voltage_readback_V", "temperature": "temperature_C"}
        reply = self.measure.reply if self.measure is not None else None
        return reply is not None and f"(?P<{group.get(role, role)}>" in reply


AnyLink = ModbusTcpLink | ModbusRtuLink | RtuOverTcpLink | SerialLineLink
LinkConfig = Annotated[AnyLink, Field(discriminator="kind")]
