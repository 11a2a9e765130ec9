"""Links to the bench: Modbus TCP, Modbus RTU, ASCII lines over a serial port, and two devices combined."""

from piezod.transport.factory import check_encodable, make_link
from piezod.transport.identity import verify_identity
from piezod.transport.link import ACKNOWLEDGED, ExchangeResult, Link, Reading
from piezod.transport.wire_rate import max_wire_rate_Hz

__all__ = [
    "ACKNOWLEDGED",
    "ExchangeResult",
    "Link",
    "Reading",
    "check_encodable",
    "make_link",
    "max_wire_rate_Hz",
    "verify_identity",
]
