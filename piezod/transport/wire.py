"""The interface between a Modbus link and its wire (TCP connection or serial port)."""

from typing import Protocol

from piezod.transport.bad_exchange import BadExchange
from piezod.transport.frames import Framing, Request
from piezod.transport.link import ExchangeResult


class Wire(Protocol):
    """Transmits one request and receives its reply; only `open` raises.

    Attributes
    ----------
    payload
        Buffer that begins with the last valid reply.
    exception_code
        Code of the last Modbus exception; 0: none.
    hint
        Probable cause of the last failures; empty: unknown.
    answered
        Whether the device has replied on the present connection.
    bad_exchange
        Bytes of the last failed exchange.
    """

    framing: Framing
    payload: memoryview
    exception_code: int
    hint: str
    answered: bool
    bad_exchange: BadExchange

    @property
    def generation(self) -> int:
        """Number of connections so far; the command sequence is valid within one connection only."""
        ...

    @property
    def stale_bytes(self) -> int:
        """Number of discarded bytes."""
        ...

    @property
    def description(self) -> str:
        """Kind and address of the link, for messages."""
        ...

    def open(self) -> None:
        """Connect; raises UnreachableError or BusyError."""
        ...

    def close(self) -> None:
        """Disconnect and stay disconnected until the next `open`."""
        ...

    def ensure_open(self, deadline_s: float) -> ExchangeResult:
        """Reconnect if disconnected, until `deadline_s` on the monotonic clock."""
        ...

    def transact(self, request: Request, deadline_s: float) -> ExchangeResult:
        """Send `request` and receive the reply into `payload`, until `deadline_s` on the monotonic clock."""
        ...
