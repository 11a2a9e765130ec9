"""The interface between control loop and bench, independent of device and wire."""

from enum import IntEnum
from math import nan
from typing import Any, Protocol


class ExchangeResult(IntEnum):
    """Result of one exchange; unless OK, the reply is discarded and the reading keeps its last values."""

    OK = 0
    TIMEOUT = 1  # no complete reply before the deadline; the connection was closed
    DISCONNECTED = 2  # refused, reset or closed by the device, or the port disappeared
    WRONG_TRANSACTION = 3  # only replies to other requests before the deadline
    WRONG_UNIT = 4  # reply of another unit
    WRONG_FUNCTION = 5  # reply with another function code
    WRONG_COUNT = 6  # wrong number of bytes, or another address than requested
    BAD_CRC = 7  # wrong checksum: noise, or another baudrate or parity
    MALFORMED = 8  # not a reply of this protocol
    DEVICE_EXCEPTION = 9  # Modbus exception; its code is `last_exception`
    NOT_FINITE = 10  # a value is nan or infinite
    OUT_OF_RANGE = 11  # a value lies outside low..high, or the voltage cannot be encoded (then nothing was sent)
    HEARTBEAT_STOOD = 12  # the heartbeat did not advance: an old reading, or the device restarted
    ECHO_MISMATCH = 13  # the reading belongs to an earlier command
    UNVERIFIED = 14  # reconnected; the identity of the device is being compared, and nothing was written
    WRONG_DEVICE = 15  # identity, map version or byte order differs from the configuration; nothing was written
    WRONG_LOAD_CELL = 16  # the same for the load cell of a pair; the amplifier took the voltage
    SETTING_CHANGED = 17  # a register that was written in set-up has another value; it was written again
    FOREIGN_COMMAND = 18  # the device has received a command of another program
    SETPOINT_CHANGED = 19  # the device holds another set point than the last one written


# The device confirmed the last request and applied its voltage; in the last three, the values read are invalid.
ACKNOWLEDGED = frozenset(
    {ExchangeResult.OK, ExchangeResult.NOT_FINITE, ExchangeResult.OUT_OF_RANGE, ExchangeResult.HEARTBEAT_STOOD}
)
ANY = -1  # in place of the number of a connection: a voltage may be sent on every one


class Reading:
    """Values of the last valid exchange; a missing quantity is nan, a missing counter 0.

    Each link has one instance and overwrites it in place.

    Attributes
    ----------
    force_N, voltage_readback_V, temperature_C, reference_N
        Values in the unit of the name.
    heartbeat, command_echo, status, reference_counter
        Raw counters and status bits.
    """

    __slots__ = (
        "command_echo",
        "force_N",
        "heartbeat",
        "reference_N",
        "reference_counter",
        "status",
        "temperature_C",
        "voltage_readback_V",
    )

    def __init__(self) -> None:
        self.force_N = nan
        self.voltage_readback_V = nan
        self.temperature_C = nan
        self.reference_N = nan
        self.heartbeat = 0
        self.command_echo = 0
        self.status = 0
        self.reference_counter = 0


class Link(Protocol):
    """Connection to one bench: writes a voltage and reads force, voltage and status.

    Attributes
    ----------
    reading
        Values of the last valid exchange.
    counts
        Number of exchanges by `ExchangeResult`.
    time_limit_s
        Longest duration of the next exchange [s]; effective if shorter than the configured timeout.
    output_confirmed
        Whether the amplifier took the last voltage although the exchange failed; only a pair of devices can say so.
    """

    reading: Reading
    counts: list[int]
    time_limit_s: float

    @property
    def output_confirmed(self) -> bool:
        """Whether the amplifier took the last voltage although the exchange failed."""
        ...

    @property
    def supervised(self) -> int:
        """Number of calls of `supervise` that compare every register once."""
        ...

    @property
    def holds_command(self) -> bool:
        """Whether the last command can be read from the device, by `compare_command`."""
        ...

    @property
    def written_V(self) -> float:
        """Last transmitted voltage [V], after scaling and rounding; nan before the first."""
        ...

    @property
    def description(self) -> str:
        """Kind and address of the link, for messages."""
        ...

    @property
    def last_exception(self) -> int:
        """Code of the last Modbus exception; 0: none."""
        ...

    @property
    def stale_bytes(self) -> int:
        """Number of discarded bytes: unrequested or too late."""
        ...

    @property
    def hint(self) -> str:
        """Probable cause of the last failures; empty: unknown."""
        ...

    def keep_bad_exchange_in(self, cells: Any, link: int = 0) -> None:  # noqa: ANN401  # any object with the buffer protocol
        """Write the bytes of failed exchanges into this memory from now on.

        Parameters
        ----------
        cells
            Memory of `bad_exchange.SIZE` bytes.
        link
            Index in `bad_exchange.LINKS`.
        """
        ...

    def open(self) -> None:
        """Connect.

        Raises
        ------
        UnreachableError
            No device answers.
        BusyError
            Another process or client uses the port or the device.
        """
        ...

    def close(self) -> None:
        """Disconnect; a second call has no effect."""
        ...

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] and read the block; never raises, returns within the timeout."""
        ...

    def poll(self) -> ExchangeResult:
        """Read the block without writing, with the same checks."""
        ...

    def accept_foreign_command(self) -> None:
        """After ECHO_MISMATCH: compare with the command that the device holds now, until the next one is sent."""
        ...

    def supervise(self, time_limit_s: float) -> ExchangeResult:
        """Read the next register that must not change: identity, map version, or a setting written in set-up.

        Never raises; returns within `time_limit_s` [s] and the timeout of the link.

        Returns
        -------
        ExchangeResult
            OK, WRONG_DEVICE, WRONG_LOAD_CELL, SETTING_CHANGED, or the failure of the exchange.
        """
        ...

    def compare_command(self) -> ExchangeResult:
        """Read the command that the device holds, and compare it with the last one written; never raises.

        Returns
        -------
        ExchangeResult
            OK, also where the last command was refused or sent on another connection. FOREIGN_COMMAND: another number.
            SETPOINT_CHANGED: the number agrees, the voltage differs. Otherwise the failure of the exchange.
        """
        ...

    def has(self, role: str) -> bool:
        """Whether the device has a register or a reply field for this role."""
        ...

    def read_register(self, role: str) -> float:
        """Read one register; for set-up, not in a tick.

        Raises
        ------
        PiezodError
            The register does not exist, or the device refuses or does not answer.
        """
        ...

    def write_register(self, role: str, value: float) -> None:
        """Write one register; for set-up, not in a tick.

        Raises
        ------
        PiezodError
            The register does not exist or cannot hold the value, or the device refuses or does not answer.
        """
        ...

    def identify(self) -> None:
        """Compare the device with the expected identity, map version and byte order.

        Raises
        ------
        IdentityError
            The device, its map or its byte order differs.
        """
        ...
