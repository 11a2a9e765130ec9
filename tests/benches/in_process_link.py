"""A link to a device object in this process, with neither socket nor port."""

from math import inf, isfinite, nan
from typing import Protocol

from piezod.errors import ConfigurationError
from piezod.transport import ExchangeResult, Reading


class Device(Protocol):
    """The device object that an `InProcessLink` calls."""

    def exchange(self, voltage_V: float | None) -> "Reading | ExchangeResult":
        """Apply a voltage [V], None to read only; return a reading, or the result of a failed exchange."""
        ...


class InProcessLink:
    """Passes every voltage to a device object and accepts its answer unchecked.

    Parameters
    ----------
    device
        Replaces the bench.
    registers
        Values of the set-up registers by role.
    """

    __slots__ = ("_device", "_registers", "counts", "reading", "time_limit_s", "written_V")
    description = "in process"
    last_exception = 0
    stale_bytes = 0
    hint = ""
    output_confirmed = False
    supervised = 0
    holds_command = False

    def __init__(self, device: Device, registers: dict[str, float] | None = None) -> None:
        self._device = device
        self._registers = dict(registers or {})
        self.reading = Reading()
        self.written_V = nan
        self.counts = [0] * len(ExchangeResult)
        self.time_limit_s = inf

    def open(self) -> None:
        """Do nothing: there is no connection."""

    def close(self) -> None:
        """Do nothing: there is no connection."""

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] and read."""
        if not isfinite(voltage_V):
            self.counts[ExchangeResult.OUT_OF_RANGE] += 1
            return ExchangeResult.OUT_OF_RANGE
        self.written_V = voltage_V
        return self._store(self._device.exchange(voltage_V))

    def accept_foreign_command(self) -> None:
        """Do nothing: nobody else writes."""

    def poll(self) -> ExchangeResult:
        """Read without writing."""
        return self._store(self._device.exchange(None))

    def _store(self, answer: "Reading | ExchangeResult") -> ExchangeResult:
        result = ExchangeResult.OK
        if isinstance(answer, ExchangeResult):
            result = answer
        else:
            for name in Reading.__slots__:
                setattr(self.reading, name, getattr(answer, name))
        self.counts[result] += 1
        return result

    def compare_command(self) -> ExchangeResult:
        """Nobody else writes."""
        return ExchangeResult.OK

    def supervise(self, time_limit_s: float) -> ExchangeResult:
        """No register is supervised."""
        return ExchangeResult.OK

    def has(self, role: str) -> bool:
        """Whether `registers` holds this role."""
        return role in self._registers

    def read_register(self, role: str) -> float:
        """Read one of `registers`."""
        if role not in self._registers:
            raise ConfigurationError(f"in-process link: has no register '{role}'")
        return self._registers[role]

    def write_register(self, role: str, value: float) -> None:
        """Write one of `registers`."""
        self.read_register(role)
        self._registers[role] = value

    def identify(self) -> None:
        """Do nothing: no identity is configured."""
