"""Kinds of serial ports by the names that Linux gives them."""

import os
from pathlib import Path

KINDS = {
    "ttyUSB": "USB adapter",
    "ttyACM": "USB device with a serial interface of its own",
    "ttyAMA": "serial port of the board",
    "ttyS": "serial port of the board",
    "ttyTHS": "serial port of the board",
    "ttymxc": "serial port of the board",
}
"""Kind by the begin of a name: Documentation/admin-guide/devices.txt of the kernel."""
SERVICE_PORTS = ("ttyS", "ttyUSB", "ttyACM", "ttyAMA")
"""Begins of the names of ports that `systemd/piezod.service` allows (`DeviceAllow`)."""
BUILT_IN = "serial port of the board"


def port_kind(port: str) -> str:
    """Kind of a serial port; empty: unknown.

    Parameters
    ----------
    port
        Path, such as /dev/ttyAMA0.
    """
    name = Path(port).name
    return next(
        (kind for begin, kind in KINDS.items() if name.startswith(begin) and name[len(begin) :].isdecimal()), ""
    )


def is_allowed_in_service(port: str) -> bool:
    """Whether `systemd/piezod.service` allows a serial port; a link such as /dev/serial/by-id/... is followed.

    A pseudo terminal of an emulator, which no service uses, counts as allowed.

    Parameters
    ----------
    port
        Path of the port.
    """
    name = Path(os.path.realpath(port)).name
    return not name.startswith("tty") or name.rstrip("0123456789") in SERVICE_PORTS


def missing_port_remedy(port: str) -> str:
    """Question that helps to find a port that does not exist."""
    if port_kind(port) == BUILT_IN:
        return "is this port enabled on the board? dmesg | grep tty lists those of the kernel"
    return "is the adapter plugged in? ls /dev/serial/by-id"
