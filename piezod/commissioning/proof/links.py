"""Links of the proof test: the link of the bench, with one reading or the result of an exchange changed."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from piezod.transport import ExchangeResult, Link, Reading

Change = Callable[[Any], Any]


@dataclass(frozen=True)
class Changes:
    """Changes of the report of a link.

    Parameters
    ----------
    readings
        Function of the value for each attribute of the reading that is changed.
    result
        Result in place of OK; None: the result of the exchange.
    silent
        Whether nothing is sent; the result is then TIMEOUT.
    now
        Whether to change now, while the link is active.
    """

    readings: dict[str, Change] = field(default_factory=dict)
    result: ExchangeResult | None = None
    silent: bool = False
    now: Callable[[], bool] = lambda: True


UNCHANGED = Changes()


class _ChangedReading:
    """The reading of a link, with its changes."""

    def __init__(self, link: "ChangedLink", reading: Reading) -> None:
        self._link, self._reading = link, reading

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # a value of the device
        value, changes = getattr(self._reading, name), self._link.changes.readings
        return changes[name](value) if name in changes and self._link.is_changed else value


class ChangedLink:
    """A link that changes its report while `active`; it passes on everything else.

    Parameters
    ----------
    active
        Whether to change now.

    Attributes
    ----------
    changes
        Present changes.
    """

    def __init__(self, link: Link, active: Callable[[], bool]) -> None:
        self._link, self._active, self.changes = link, active, UNCHANGED
        self._silenced = False
        self.reading = _ChangedReading(self, link.reading)

    @property
    def is_changed(self) -> bool:
        """Whether to change now."""
        return self.changes is not UNCHANGED and self._active() and self.changes.now()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # everything else is the link's own
        return getattr(self._link, name)

    @property
    def time_limit_s(self) -> float:
        """Longest duration of the next exchange [s]."""
        return self._link.time_limit_s

    @time_limit_s.setter
    def time_limit_s(self, value: float) -> None:
        self._link.time_limit_s = value

    @property
    def output_confirmed(self) -> bool:
        """Whether the amplifier took the last voltage although the exchange failed."""
        return not self._silenced and self._link.output_confirmed

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] and read, unless the link is silent."""
        return self._changed(lambda: self._link.exchange(voltage_V))

    def poll(self) -> ExchangeResult:
        """Read without writing, unless the link is silent."""
        return self._changed(self._link.poll)

    def _changed(self, call: Callable[[], ExchangeResult]) -> ExchangeResult:
        active, changes = self.is_changed, self.changes
        self._silenced = changes.silent and active
        if self._silenced:
            return ExchangeResult.TIMEOUT
        result = call()
        return changes.result if active and changes.result is not None and result == ExchangeResult.OK else result


def frozen() -> Change:
    """Change of a reading that keeps its first value."""
    first: list[Any] = []

    def keep(value: Any) -> Any:  # noqa: ANN401  # any quantity
        if not first:
            first.append(value)
        return first[0]

    return keep


def shifted(by: float) -> Change:
    """Change of a reading that is `by` too high, in the unit of the reading."""
    return lambda value: value + by


def with_bits(bits: int) -> Change:
    """Change of status bits that are set in addition."""
    return lambda value: value | bits


def without_bits(bits: int) -> Change:
    """Change of status bits that are cleared."""
    return lambda value: value & ~bits
