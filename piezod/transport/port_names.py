"""Kinds of serial ports by the names that Linux gives them."""

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


def missing_port_remedy(port: str) -> str:
    """Question that helps to find a port that does not exist."""
    if port_kind(port) == BUILT_IN:
        return "is this port enabled on the board? dmesg | grep tty lists those of the kernel"
    return "is the adapter plugged in? ls /dev/serial/by-id"
