"""What can be found before a bench file exists: serial ports by their lasting names, and a Modbus device's own name."""

import logging
from dataclasses import dataclass
from pathlib import Path

from pymodbus import ModbusException
from pymodbus.client import ModbusTcpClient
from serial.tools import list_ports

BY_ID = Path("/dev/serial/by-id")  # udev's names: they stay when another adapter is plugged in


@dataclass(frozen=True)
class FoundPort:
    """A serial port: the name to write down, and what the adapter says it is."""

    path: str
    description: str


def serial_ports(by_id: Path = BY_ID) -> list[FoundPort]:
    """Serial ports of this machine, by their lasting names where udev gives them.

    Parameters
    ----------
    by_id
        Folder of the lasting names.
    """
    lasting = {str(link.resolve()): str(link) for link in sorted(by_id.iterdir())} if by_id.is_dir() else {}
    found = {port.device: port.description for port in list_ports.comports()}
    devices = sorted({*lasting, *found})
    return [FoundPort(lasting.get(device, device), found.get(device) or device) for device in devices]


def modbus_name(host: str, port: int, unit_id: int, timeout_s: float = 1.0) -> str:
    """What a Modbus TCP device calls itself (function 43/14); in words where it does not say, empty where none answers.

    Parameters
    ----------
    host, port, unit_id
        Where it is.
    timeout_s
        For the connection and for its answer.
    """
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # that nobody answers is an answer here
    with ModbusTcpClient(host, port=port, timeout=timeout_s, retries=0) as client:
        if not client.connected:
            return ""
        try:
            answer = client.read_device_information(device_id=unit_id)
        except ModbusException:
            return "a device that does not answer to function 43"
    if answer.isError():
        return "a device without a name (it does not know function 43)"
    words = [text.decode("utf-8", "replace").strip() for _, text in sorted(answer.information.items())]
    return " ".join(word for word in words if word.isprintable() and word) or "a device without a name"
