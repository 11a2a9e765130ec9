"""Two devices combined into one link: an amplifier for the voltage and a load cell for the force."""

from typing import Any

from piezod.transport.link import ACKNOWLEDGED, ExchangeResult, Link, Reading

_OK = ExchangeResult.OK
_FIELDS = {
    "force": "force_N",
    "voltage_readback": "voltage_readback_V",
    "temperature": "temperature_C",
    "reference": "reference_N",
    "heartbeat": "heartbeat",
    "command_echo": "command_echo",
    "status": "status",
    "reference_counter": "reference_counter",
}
_PREFER_LOAD_CELL = ("force", "reference", "reference_counter")


class PairLink:
    """Exchanges with the amplifier first, then reads the load cell; both must succeed.

    An amplifier that took its voltage stays under control when the load cell fails: `output_confirmed` is then True.
    Force and reference come from the load cell. Any other quantity of both devices comes from the amplifier.

    Parameters
    ----------
    amplifier
        Link of the amplifier; receives the voltage.
    load_cell
        Link of the load cell; measures the force.
    """

    __slots__ = (
        "_amplifier",
        "_load_cell",
        "_next",
        "_of_amplifier",
        "_of_load_cell",
        "counts",
        "output_confirmed",
        "reading",
    )

    def __init__(self, amplifier: Link, load_cell: Link) -> None:
        self._amplifier, self._load_cell = amplifier, load_cell
        of_cell = [role for role in _FIELDS if load_cell.has(role)]
        of_amplifier = [role for role in _FIELDS if amplifier.has(role)]
        self._of_load_cell = tuple(
            _FIELDS[role] for role in of_cell if role in _PREFER_LOAD_CELL or role not in of_amplifier
        )
        self._of_amplifier = tuple(_FIELDS[role] for role in of_amplifier if _FIELDS[role] not in self._of_load_cell)
        self.reading = Reading()
        self.counts = [0] * len(ExchangeResult)
        self.output_confirmed = False
        self._next = 0

    @property
    def time_limit_s(self) -> float:
        """Longest duration of the next exchange with each device [s]."""
        return self._amplifier.time_limit_s

    @time_limit_s.setter
    def time_limit_s(self, value: float) -> None:
        self._amplifier.time_limit_s = self._load_cell.time_limit_s = value

    @property
    def description(self) -> str:
        """Kinds and addresses of both links, for messages."""
        return f"{self._amplifier.description} and {self._load_cell.description}"

    @property
    def written_V(self) -> float:
        """Last transmitted voltage [V]."""
        return self._amplifier.written_V

    @property
    def last_exception(self) -> int:
        """Code of the last Modbus exception of either device; 0: none."""
        return self._amplifier.last_exception or self._load_cell.last_exception

    @property
    def stale_bytes(self) -> int:
        """Number of bytes discarded by both links."""
        return self._amplifier.stale_bytes + self._load_cell.stale_bytes

    def keep_bad_exchange_in(self, cells: Any, link: int = 0) -> None:  # noqa: ANN401  # any object with the buffer protocol
        """Write the bytes of failed exchanges of either device into this memory from now on."""
        self._amplifier.keep_bad_exchange_in(cells, link)
        self._load_cell.keep_bad_exchange_in(cells, link + 1)

    @property
    def hint(self) -> str:
        """Probable cause of the last failures of either link; empty: unknown."""
        return self._amplifier.hint or self._load_cell.hint

    def open(self) -> None:
        """Connect both links, or neither; raises UnreachableError or BusyError."""
        self._amplifier.open()
        try:
            self._load_cell.open()
        except BaseException:
            self._amplifier.close()
            raise

    def close(self) -> None:
        """Disconnect both; a second call has no effect."""
        self._amplifier.close()
        self._load_cell.close()

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] to the amplifier, then read the load cell; returns within the sum of both timeouts."""
        result = self._amplifier.exchange(voltage_V)
        self.output_confirmed = result in ACKNOWLEDGED
        return self._combine(self._poll_load_cell() if result is _OK else result)

    def poll(self) -> ExchangeResult:
        """Read both without writing."""
        result = self._amplifier.poll()
        return self._combine(self._poll_load_cell() if result is _OK else result)

    def accept_foreign_command(self) -> None:
        """Of the amplifier; a load cell takes no command."""
        self._amplifier.accept_foreign_command()

    def _poll_load_cell(self) -> ExchangeResult:
        result = self._load_cell.poll()
        return ExchangeResult.WRONG_LOAD_CELL if result is ExchangeResult.WRONG_DEVICE else result

    @property
    def supervised(self) -> int:
        """Number of calls of `supervise` that compare every register of both devices once."""
        return self._amplifier.supervised + self._load_cell.supervised

    @property
    def holds_command(self) -> bool:
        """Whether the last command can be read from the amplifier."""
        return self._amplifier.holds_command

    def compare_command(self) -> ExchangeResult:
        """Compare the command that the amplifier holds with the last one written."""
        return self._amplifier.compare_command()

    def supervise(self, time_limit_s: float) -> ExchangeResult:
        """Read the next register that must not change, first those of the amplifier."""
        if self._next < self._amplifier.supervised:
            result = self._amplifier.supervise(time_limit_s)
        else:
            result = self._load_cell.supervise(time_limit_s)
            if result is ExchangeResult.WRONG_DEVICE:
                result = ExchangeResult.WRONG_LOAD_CELL
        if result is _OK:
            self._next = (self._next + 1) % max(1, self.supervised)
        return result

    def _combine(self, result: ExchangeResult) -> ExchangeResult:
        self.counts[result] += 1
        if result is _OK:
            reading, source = self.reading, self._amplifier.reading
            for name in self._of_amplifier:
                setattr(reading, name, getattr(source, name))
            source = self._load_cell.reading
            for name in self._of_load_cell:
                setattr(reading, name, getattr(source, name))
        return result

    def has(self, role: str) -> bool:
        """Whether either device has a register or a reply field for this role."""
        return self._amplifier.has(role) or self._load_cell.has(role)

    def read_register(self, role: str) -> float:
        """Read one register of the device that has it."""
        return self._owner(role).read_register(role)

    def write_register(self, role: str, value: float) -> None:
        """Write one register of the device that has it."""
        self._owner(role).write_register(role, value)

    def identify(self) -> None:
        """Compare both devices with their expected identity; raises IdentityError."""
        self._amplifier.identify()
        self._load_cell.identify()

    def _owner(self, role: str) -> Link:
        cell_first = role in _PREFER_LOAD_CELL and self._load_cell.has(role)
        return self._load_cell if cell_first or not self._amplifier.has(role) else self._amplifier
