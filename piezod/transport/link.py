"""What the control loop asks of a link, whatever device and wire are behind it."""

from enum import IntEnum
from math import nan
from typing import Protocol


class ExchangeResult(IntEnum):
    """How one exchange ended; of any but OK nothing of the reply was used."""

    OK = 0
    TIMEOUT = 1  # no whole reply until the deadline; the connection was closed
    DISCONNECTED = 2  # refused, reset, closed by the other side, or the port vanished
    WRONG_TRANSACTION = 3  # until the deadline only replies to other requests came
    WRONG_UNIT = 4  # another unit answered
    WRONG_FUNCTION = 5  # another function was answered
    WRONG_COUNT = 6  # fewer or more bytes, or another address, than asked for
    BAD_CRC = 7  # checksum wrong: noise, or another baudrate or parity
    MALFORMED = 8  # no reply of this protocol at all
    DEVICE_EXCEPTION = 9  # the device refused; its code is `last_exception`
    NOT_FINITE = 10  # a value is nan or infinite
    OUT_OF_RANGE = 11  # a value lies outside low..high, or the voltage cannot be encoded (then nothing was sent)
    HEARTBEAT_STOOD = 12  # the device's counter stood still or went back: an old reading, or a device that restarted
    ECHO_MISMATCH = 13  # the reading answers another command than the last one


# The device answered this very request, so the voltage was taken; only what it read cannot be believed.
ACKNOWLEDGED = frozenset(
    {ExchangeResult.OK, ExchangeResult.NOT_FINITE, ExchangeResult.OUT_OF_RANGE, ExchangeResult.HEARTBEAT_STOOD}
)


class Reading:
    """What the device last said, every check passed; quantities that it does not have are nan, counters 0.

    One instance a link, overwritten in place.

    Attributes
    ----------
    force_N, voltage_readback_V, temperature_C, reference_N
        Values in the unit that their name carries.
    heartbeat, command_echo, status, reference_counter
        Raw counters and bits.
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
    """A way to one bench: write a voltage, read what the bench says.

    Attributes
    ----------
    reading
        What the last good exchange read.
    counts
        Exchanges by `ExchangeResult`.
    patience_s
        How long the next exchange may last [s], when that is less than the link's own timeout.
    """

    reading: Reading
    counts: list[int]
    patience_s: float

    @property
    def written_V(self) -> float:
        """The voltage as it last went on the wire [V], after scale and rounding; nan before the first."""
        ...

    @property
    def description(self) -> str:
        """Kind and address, for people."""
        ...

    @property
    def last_exception(self) -> int:
        """Code of the last Modbus exception, 0 when there was none."""
        ...

    @property
    def stale_bytes(self) -> int:
        """Bytes that arrived unasked or too late, and were discarded."""
        ...

    @property
    def hint(self) -> str:
        """What probably is wrong; empty when nothing is known."""
        ...

    def open(self) -> None:
        """Connect.

        Raises
        ------
        UnreachableError
            Nobody answers there.
        BusyError
            Somebody else holds the port or the device.
        """
        ...

    def close(self) -> None:
        """Disconnect; may be called twice."""
        ...

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] and read the block; never raises, lasts at most the link's timeout."""
        ...

    def poll(self) -> ExchangeResult:
        """Read the block without writing; the same checks."""
        ...

    def has(self, role: str) -> bool:
        """Whether the device has a register (or a field of a reply) for this role."""
        ...

    def read_register(self, role: str) -> float:
        """Read one register, outside the tick.

        Raises
        ------
        PiezodError
            The device has none, refuses, or does not answer.
        """
        ...

    def write_register(self, role: str, value: float) -> None:
        """Write one register, outside the tick.

        Raises
        ------
        PiezodError
            The device has none, refuses, or does not answer; or the value does not fit the register.
        """
        ...

    def identify(self) -> None:
        """Compare what is known of the device with what it answers.

        Raises
        ------
        IdentityError
            Another device, map or byte order.
        """
        ...
