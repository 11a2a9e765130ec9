"""Search for devices before a bench file exists: serial ports, and the name of a Modbus device."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymodbus import FramerType, ModbusException
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from serial.tools import list_ports

from piezod.config.link import ModbusRtuLink
from piezod.transport.port_names import port_kind

SILENT = "a device that does not answer to function 43"
TIMEOUT_S = 1.0  # for the connection and for the reply
BY_ID = Path("/dev/serial/by-id")  # persistent names by udev, independent of other adapters


@dataclass(frozen=True)
class FoundPort:
    """A serial port: its path for the bench file, and the description by the adapter."""

    path: str
    description: str


def serial_ports(by_id: Path = BY_ID) -> list[FoundPort]:
    """Serial ports of this machine, with the persistent path where udev provides one."""
    persistent = {str(link.resolve()): str(link) for link in sorted(by_id.iterdir())} if by_id.is_dir() else {}
    found = {port.device: port.description for port in list_ports.comports()}
    devices = sorted({*persistent, *found})
    return [FoundPort(persistent.get(device, device), _described(device, found.get(device))) for device in devices]


def _described(device: str, description: str | None) -> str:
    """Description by the adapter, else the kind of port by its name."""
    if description and description not in ("n/a", Path(device).name):
        return description
    return port_kind(device) or device


def modbus_name(host: str, port: int, unit_id: int, *, rtu: bool = False) -> str:
    """Name of a device on the network by function 43/14, or a text that it has none; empty: no device answers.

    Parameters
    ----------
    rtu
        Whether a serial gateway expects RTU frames.
    """
    framer = FramerType.RTU if rtu else FramerType.SOCKET
    return _name(ModbusTcpClient(host, port=port, timeout=TIMEOUT_S, retries=0, framer=framer), unit_id)


def rtu_name(link: ModbusRtuLink) -> str:
    """Name of a device on a serial line, as `modbus_name`."""
    client = ModbusSerialClient(
        link.port,
        baudrate=link.baudrate,
        bytesize=link.bytesize,
        parity=link.parity,
        stopbits=link.stopbits,
        timeout=TIMEOUT_S,
        retries=0,
    )
    return _name(client, link.unit_id)


def _name(client: ModbusTcpClient | ModbusSerialClient, unit_id: int) -> str:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # a missing device is a normal result, not an error
    with client:
        if not client.connected:
            return ""
        try:
            answer: Any = client.read_device_information(device_id=unit_id)
        except ModbusException:
            return SILENT
    if answer.isError():
        return "a device without a name (it does not know function 43)"
    words = [text.decode("utf-8", "replace").strip() for _, text in sorted(answer.information.items())]
    return " ".join(word for word in words if word.isprintable() and word) or "a device without a name"
