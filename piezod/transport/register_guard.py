"""Registers that must not change while a bench is driven: identity, map version, byte order, and settings.

The values of identity are compared at every connection, before anything is written: after a reconnection, another
device may answer. While voltages are written, identity and settings are read again in turn. A setting is a register
that was written in set-up, such as the watchdog of the device.
"""

from dataclasses import dataclass

from piezod.config.link import ExpectedRegister, Register, Registers
from piezod.runtime import clock
from piezod.transport.frames import Request, read_request
from piezod.transport.identity import agrees
from piezod.transport.link import ExchangeResult
from piezod.transport.registers import RegisterCodec
from piezod.transport.wire import Wire

IDENTITY_ROLES = ("order_check", "identity", "map_version")

_OK = ExchangeResult.OK


@dataclass(frozen=True)
class _IdentityBlock:
    """Registers of identity without a gap between them, read by one request."""

    request: Request
    members: tuple[tuple[ExpectedRegister, RegisterCodec, int], ...]  # register, codec, position in the block [bytes]

    def compare(self, wire: Wire) -> ExchangeResult:
        """Compare the reply to `request` with the expected values."""
        for register, codec, at in self.members:
            found = codec.unpack_from(wire.payload, self.request.payload_at + at)
            if not agrees(found, register.expect):
                return ExchangeResult.WRONG_DEVICE
        return _OK


@dataclass(frozen=True)
class _Setting:
    """A register that was written in set-up, and the request that writes it again."""

    request: Request
    raw: bytes
    again: Request

    def compare(self, wire: Wire) -> ExchangeResult:
        """Compare the reply to `request` with the written bytes."""
        at = self.request.payload_at
        return _OK if wire.payload[at : at + len(self.raw)] == self.raw else ExchangeResult.SETTING_CHANGED


class RegisterGuard:
    """Compares the registers that must not change, at each connection and in turn while driving."""

    __slots__ = (
        "_blocks",
        "_compared",
        "_next",
        "_reading_generation",
        "_settings",
        "_unit",
        "_verified",
        "_wire",
    )

    def __init__(self, wire: Wire, unit_id: int, registers: Registers) -> None:
        self._wire, self._unit = wire, unit_id
        self._blocks = [_block(wire, unit_id, members) for members in _neighbours(registers)]
        self._settings: dict[str, _Setting] = {}
        self._verified = self._reading_generation = -1
        self._compared = self._next = 0

    @property
    def count(self) -> int:
        """Number of reads in one turn over all registers."""
        return len(self._blocks) + len(self._settings)

    def is_verified(self) -> bool:
        """Whether the identity was compared on the present connection."""
        return self._verified == self._wire.generation

    def mark_verified(self, generation: int) -> None:
        """Note that the identity was compared on the connection with this number."""
        self._verified = generation

    def note_setting(self, role: str, register: Register, written: Request) -> None:
        """Keep the value of a set-up register that the device has confirmed.

        Parameters
        ----------
        written
            Request that wrote it.
        """
        function = 4 if register.function == 4 else 3
        request = read_request(self._wire.framing, self._unit, function, register.address, register.words)
        at = written.values_at
        self._settings[role] = _Setting(request, bytes(written.frame[at : at + 2 * register.words]), written)

    def verify(self, deadline_s: float) -> ExchangeResult:
        """Compare the identity on a new connection; to be called before anything is written to it.

        Returns
        -------
        ExchangeResult
            OK: verified, and time for an exchange is left. UNVERIFIED: half of the time has passed; the next call
            continues. Otherwise the failure.
        """
        generation = self._wire.generation
        if generation != self._reading_generation:
            self._reading_generation, self._compared = generation, 0
        half_s = 0.5 * (clock.monotonic() + deadline_s)
        for block in self._blocks[self._compared :]:
            result = self._wire.transact(block.request, deadline_s)
            if result is _OK:
                result = self._compare(block)
            if result is not _OK:
                return result
            self._compared += 1
            if clock.monotonic() > half_s:
                return ExchangeResult.UNVERIFIED
        self._verified = generation
        return _OK

    def check_next(self, deadline_s: float) -> ExchangeResult:
        """Read the next register in turn; a setting that changed is written again.

        Returns
        -------
        ExchangeResult
            OK: as expected. WRONG_DEVICE: nothing more is written on this connection before `verify` succeeds.
            SETTING_CHANGED. Otherwise the failure. Unless it is OK, the next call repeats the read.
        """
        if not self.is_verified():
            return ExchangeResult.UNVERIFIED
        entries: list[_Setting | _IdentityBlock] = [*self._settings.values(), *self._blocks]
        if not entries:
            return _OK
        entry = entries[self._next % len(entries)]
        result = self._wire.transact(entry.request, deadline_s)
        if result is not _OK:
            return result
        result = self._compare(entry)
        if result is _OK:
            self._next += 1
        elif isinstance(entry, _Setting):
            self._wire.transact(entry.again, deadline_s)  # whether it was written, the next call reads
        else:
            self._verified = self._reading_generation = -1
        return result

    def _compare(self, entry: _Setting | _IdentityBlock) -> ExchangeResult:
        """Compare the reply with the expected bytes; keep a reply that differs."""
        wire, request = self._wire, entry.request
        result = entry.compare(wire)
        if result is not _OK:
            wire.bad_exchange.keep(result, request.frame, wire.payload, request.reply_size)
        return result


def _neighbours(registers: Registers) -> list[list[ExpectedRegister]]:
    """Registers of identity in groups that one request can read: same function, no gap between them."""
    found = [register for role in IDENTITY_ROLES if (register := getattr(registers, role)) is not None]
    found.sort(key=lambda register: (register.function == 4, register.address))
    groups: list[list[ExpectedRegister]] = []
    for register in found:
        before = groups[-1][-1] if groups else None
        adjacent = before is not None and before.address + before.words == register.address
        if before is not None and adjacent and (before.function == 4) == (register.function == 4):
            groups[-1].append(register)
        else:
            groups.append([register])
    return groups


def _block(wire: Wire, unit_id: int, members: list[ExpectedRegister]) -> _IdentityBlock:
    first, last = members[0], members[-1]
    count = last.address + last.words - first.address
    request = read_request(wire.framing, unit_id, 4 if first.function == 4 else 3, first.address, count)
    placed = tuple((register, RegisterCodec(register), 2 * (register.address - first.address)) for register in members)
    return _IdentityBlock(request, placed)
