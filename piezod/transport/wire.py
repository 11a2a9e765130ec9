"""What a Modbus link asks of the wire below it."""

from typing import Protocol

from piezod.transport.frames import Framing, Request
from piezod.transport.link import ExchangeResult


class Wire(Protocol):
    """Carries one request and its reply at a time; nothing here raises but `open`.

    Attributes
    ----------
    payload
        Where the last good reply stands, from its first byte on.
    exception_code
        Code of the last Modbus exception, 0 when there was none.
    hint
        What probably is wrong; empty when nothing is known.
    answered
        Whether a good reply came since it was connected.
    """

    framing: Framing
    payload: memoryview
    exception_code: int
    hint: str
    answered: bool

    @property
    def generation(self) -> int:
        """How often it was connected; a new connection knows nothing of commands sent before."""
        ...

    @property
    def stale_bytes(self) -> int:
        """Bytes discarded."""
        ...

    @property
    def description(self) -> str:
        """Kind and address, for people."""
        ...

    def open(self) -> None:
        """Connect; raises UnreachableError or BusyError."""
        ...

    def close(self) -> None:
        """Disconnect, until the next `open`."""
        ...

    def ready(self, deadline_s: float) -> ExchangeResult:
        """Connect again if it must be, until `deadline_s` on the monotonic clock."""
        ...

    def transact(self, request: Request, deadline_s: float) -> ExchangeResult:
        """Send `request` and receive its reply into `payload`, until `deadline_s` on the monotonic clock."""
        ...
