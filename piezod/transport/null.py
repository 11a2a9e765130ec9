"""A link to a device inside this process, for tests and simulation; no configuration file can name it."""

from math import inf, isfinite, nan
from typing import Protocol

from piezod.errors import ConfigurationError
from piezod.transport.link import ExchangeResult, Reading


class Device(Protocol):
    """What stands behind a `NullLink`."""

    def exchange(self, voltage_V: float | None) -> "Reading | ExchangeResult":
        """Take a voltage [V], None to be only looked at; answer a reading, or how the exchange failed."""
        ...


class NullLink:
    """Hands every voltage to a device object and believes what it answers.

    Parameters
    ----------
    device
        Stands in for the bench.
    registers
        Set-up registers by role, read and written like memory.
    """

    __slots__ = ("_device", "_registers", "counts", "patience_s", "reading", "written_V")
    description = "null"
    last_exception = 0
    stale_bytes = 0
    hint = ""

    def __init__(self, device: Device, registers: dict[str, float] | None = None) -> None:
        self._device = device
        self._registers = dict(registers or {})
        self.reading = Reading()
        self.written_V = nan
        self.counts = [0] * len(ExchangeResult)
        self.patience_s = inf

    def open(self) -> None:
        """Nothing to connect."""

    def close(self) -> None:
        """Nothing to disconnect."""

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] and read."""
        if not isfinite(voltage_V):
            self.counts[ExchangeResult.OUT_OF_RANGE] += 1
            return ExchangeResult.OUT_OF_RANGE
        self.written_V = voltage_V
        return self._take(self._device.exchange(voltage_V))

    def poll(self) -> ExchangeResult:
        """Read without writing."""
        return self._take(self._device.exchange(None))

    def _take(self, answer: "Reading | ExchangeResult") -> ExchangeResult:
        result = ExchangeResult.OK
        if isinstance(answer, ExchangeResult):
            result = answer
        else:
            for name in Reading.__slots__:
                setattr(self.reading, name, getattr(answer, name))
        self.counts[result] += 1
        return result

    def has(self, role: str) -> bool:
        """Whether `registers` names this role."""
        return role in self._registers

    def read_register(self, role: str) -> float:
        """Read one of `registers`."""
        if role not in self._registers:
            raise ConfigurationError(f"null link: has no register '{role}'")
        return self._registers[role]

    def write_register(self, role: str, value: float) -> None:
        """Write one of `registers`."""
        self.read_register(role)
        self._registers[role] = value

    def identify(self) -> None:
        """Nothing is expected."""
