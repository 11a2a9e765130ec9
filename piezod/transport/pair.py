"""Two devices as one link: the amplifier takes the voltage, the load cell gives the force."""

from piezod.transport.link import ExchangeResult, Link, Reading

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
_OF_LOAD_CELL_FIRST = ("force", "reference", "reference_counter")


class PairLink:
    """Writes to one link, then reads the other; a reading is believed when both are.

    What both have is taken from the amplifier; force and reference from the load cell.

    Parameters
    ----------
    amplifier
        Takes the voltage.
    load_cell
        Gives the force.
    """

    __slots__ = ("_amplifier", "_load_cell", "_of_amplifier", "_of_load_cell", "counts", "reading")

    def __init__(self, amplifier: Link, load_cell: Link) -> None:
        self._amplifier, self._load_cell = amplifier, load_cell
        of_cell = [role for role in _FIELDS if load_cell.has(role)]
        of_amplifier = [role for role in _FIELDS if amplifier.has(role)]
        self._of_load_cell = tuple(
            _FIELDS[role] for role in of_cell if role in _OF_LOAD_CELL_FIRST or role not in of_amplifier
        )
        self._of_amplifier = tuple(_FIELDS[role] for role in of_amplifier if _FIELDS[role] not in self._of_load_cell)
        self.reading = Reading()
        self.counts = [0] * len(ExchangeResult)

    @property
    def patience_s(self) -> float:
        """How long the next exchange with each of them may last [s]."""
        return self._amplifier.patience_s

    @patience_s.setter
    def patience_s(self, value: float) -> None:
        self._amplifier.patience_s = self._load_cell.patience_s = value

    @property
    def description(self) -> str:
        """Kinds and addresses, for people."""
        return f"{self._amplifier.description} and {self._load_cell.description}"

    @property
    def written_V(self) -> float:
        """The voltage as it last went on the wire [V]."""
        return self._amplifier.written_V

    @property
    def last_exception(self) -> int:
        """Code of the last Modbus exception of either, 0 when there was none."""
        return self._amplifier.last_exception or self._load_cell.last_exception

    @property
    def stale_bytes(self) -> int:
        """Bytes that either discarded."""
        return self._amplifier.stale_bytes + self._load_cell.stale_bytes

    @property
    def hint(self) -> str:
        """What probably is wrong with either."""
        return self._amplifier.hint or self._load_cell.hint

    def open(self) -> None:
        """Connect both, or none; raises UnreachableError or BusyError."""
        self._amplifier.open()
        try:
            self._load_cell.open()
        except BaseException:
            self._amplifier.close()
            raise

    def close(self) -> None:
        """Disconnect both; may be called twice."""
        self._amplifier.close()
        self._load_cell.close()

    def exchange(self, voltage_V: float) -> ExchangeResult:
        """Write the voltage [V] to the amplifier, then read the load cell; lasts at most both timeouts."""
        result = self._amplifier.exchange(voltage_V)
        return self._take(self._load_cell.poll() if result is _OK else result)

    def poll(self) -> ExchangeResult:
        """Read both without writing."""
        result = self._amplifier.poll()
        return self._take(self._load_cell.poll() if result is _OK else result)

    def _take(self, result: ExchangeResult) -> ExchangeResult:
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
        """Whether either has a register for this role."""
        return self._amplifier.has(role) or self._load_cell.has(role)

    def read_register(self, role: str) -> float:
        """Read one register of the one that has it."""
        return self._owner(role).read_register(role)

    def write_register(self, role: str, value: float) -> None:
        """Write one register of the one that has it."""
        self._owner(role).write_register(role, value)

    def identify(self) -> None:
        """Compare both with what is known of them; raises IdentityError."""
        self._amplifier.identify()
        self._load_cell.identify()

    def _owner(self, role: str) -> Link:
        cell_first = role in _OF_LOAD_CELL_FIRST and self._load_cell.has(role)
        return self._load_cell if cell_first or not self._amplifier.has(role) else self._amplifier
