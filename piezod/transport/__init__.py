"""Links to the bench: Modbus TCP, Modbus RTU, lines of ASCII, two devices as one, and one in this process."""

from piezod.transport.factory import check_encodable, make_link
from piezod.transport.identity import verify_identity
from piezod.transport.link import ACKNOWLEDGED, ExchangeResult, Link, Reading
from piezod.transport.null import NullLink
from piezod.transport.wire_rate import wire_floor_rate_Hz

__all__ = [
    "ACKNOWLEDGED",
    "ExchangeResult",
    "Link",
    "NullLink",
    "Reading",
    "check_encodable",
    "make_link",
    "verify_identity",
    "wire_floor_rate_Hz",
]
