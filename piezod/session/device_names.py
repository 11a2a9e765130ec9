"""Names of the device that a link leads to: equal for two bench files that drive one amplifier.

A host counts by its addresses; all addresses of this machine are equal. A serial port counts by its device
number, independent of its path or link.
"""

import contextlib
import os
import socket
import stat
from ipaddress import ip_address
from pathlib import Path

from piezod.config.link import LinkConfig, ModbusTcpLink, RtuOverTcpLink
from piezod.runtime import sockets

THIS_MACHINE = "this-machine"
_ANY_UNIT = (0, 255)  # both address the device itself, not a unit behind it (Modbus Messaging on TCP/IP, 4.4.1.1)


def device_names(link: LinkConfig) -> tuple[str, ...]:
    """Names of the device, in a fixed order; several where the host has several addresses.

    Parameters
    ----------
    link
        Section `link` of the bench configuration.
    """
    if isinstance(link, RtuOverTcpLink):  # a gateway has one line, whatever the unit: one program may drive it
        return tuple(f"gateway {address} {link.port}" for address in sorted(_addresses(link.host, link.port)))
    if not isinstance(link, ModbusTcpLink):
        return (f"serial {_serial_device(link.port)}",)
    unit = _ANY_UNIT[0] if link.unit_id in _ANY_UNIT else link.unit_id
    return tuple(f"tcp {address} {link.port} {unit}" for address in sorted(_addresses(link.host, link.port)))


def _addresses(host: str, port: int) -> set[str]:
    """Addresses of a host; its name where it cannot be resolved now."""
    try:
        infos = sockets.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError:
        return {host.lower().rstrip(".")}
    return {_machine(family, str(address[0])) for family, _, _, _, address in infos}


def _machine(family: int, address: str) -> str:
    """An address in its shortest form; `THIS_MACHINE` for loopback and for the addresses of the own interfaces."""
    parsed = ip_address(address.partition("%")[0])
    parsed = getattr(parsed, "ipv4_mapped", None) or parsed
    if parsed.is_loopback or parsed.is_unspecified or _is_own(family, address):
        return THIS_MACHINE
    return str(parsed)


def _is_own(family: int, address: str) -> bool:
    """Whether the kernel would send from the very address that it sends to; no packet is sent."""
    with contextlib.suppress(OSError), sockets.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect((address, 9))
        return bool(probe.getsockname()[0] == address)
    return False


def _serial_device(port: str) -> str:
    """Device number of a serial port; the resolved path where it is not there now."""
    with contextlib.suppress(OSError):
        status = Path(port).stat()
        if stat.S_ISCHR(status.st_mode):
            return f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}"
    return os.path.realpath(port)
