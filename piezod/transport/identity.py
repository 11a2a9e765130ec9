"""Comparison of the connected device with the configuration: identity, map version and byte order."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from piezod.config.link import ExpectedRegister
from piezod.errors import IdentityError
from piezod.transport.registers import RegisterCodec

if TYPE_CHECKING:
    from piezod.transport.link import Link

_RELATIVE = 1e-6  # float32 has seven significant digits


@dataclass(frozen=True)
class Expectation:
    """A register with a known value, its role, and the description of the device."""

    role: str
    register: ExpectedRegister
    device: str


def verify_identity(link: "Link") -> None:
    """Compare identity, map version and byte order with the registers of the device.

    Raises
    ------
    IdentityError
        A value differs; the message contains both values.
    """
    link.identify()


def check_register(expectation: Expectation, raw: bytes) -> None:
    """Compare the bytes of a register with the expected value.

    Raises
    ------
    IdentityError
        The values differ; the message contains both, and the byte order in which they agree, if any.
    """
    register = expectation.register
    found = RegisterCodec(register).unpack_from(raw, 0)
    if agrees(found, register.expect):
        return
    where = f"{expectation.device}: registers.{expectation.role} at address {register.address}"
    orders = ("AB", "BA") if register.words == 1 else ("ABCD", "CDAB", "BADC", "DCBA")
    for order in orders:
        if agrees(RegisterCodec(register, order).unpack_from(raw, 0), register.expect):
            raise IdentityError(
                f"{where} is {found:g}, expected {register.expect:g}: the device sends it in order {order}, "
                f"configured is {register.byte_order}; set order: {order}"
            )
    raise IdentityError(f"{where} is {found:g}, expected {register.expect:g}: another device, firmware or register map")


def agrees(found: float, expected: float) -> bool:
    """Whether two values are equal within the precision of a float32 register."""
    return abs(found - expected) <= _RELATIVE * abs(expected)
