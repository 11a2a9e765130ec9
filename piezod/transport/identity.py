"""Whether the device that answers is the one that the configuration names, its bytes in the order named."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from piezod.config.link import ExpectedRegister
from piezod.errors import IdentityError
from piezod.transport.registers import RegisterCodec

if TYPE_CHECKING:
    from piezod.transport.link import Link

_RELATIVE = 1e-6  # float32 carries seven digits


@dataclass(frozen=True)
class Expectation:
    """A register whose value is known, and where it is."""

    role: str
    register: ExpectedRegister
    device: str


def verify_identity(link: "Link") -> None:
    """Compare identity, map version and byte order with what the device answers.

    Raises
    ------
    IdentityError
        Names what was expected and what was found.
    """
    link.identify()


def check_register(expectation: Expectation, raw: bytes) -> None:
    """Compare the bytes of a register with the value expected.

    Raises
    ------
    IdentityError
        Names both values, and the byte order in which they would agree if there is one.
    """
    register = expectation.register
    found = RegisterCodec(register).unpack_from(raw, 0)
    if _agree(found, register.expect):
        return
    where = f"{expectation.device}: registers.{expectation.role} at address {register.address}"
    orders = ("AB", "BA") if register.words == 1 else ("ABCD", "CDAB", "BADC", "DCBA")
    for order in orders:
        if _agree(RegisterCodec(register, order).unpack_from(raw, 0), register.expect):
            raise IdentityError(
                f"{where} is {found:g}, expected {register.expect:g}: the device sends it in order {order}, "
                f"configured is {register.byte_order}; set order: {order}"
            )
    raise IdentityError(f"{where} is {found:g}, expected {register.expect:g}: another device, firmware or register map")


def _agree(found: float, expected: float) -> bool:
    return abs(found - expected) <= _RELATIVE * abs(expected)
