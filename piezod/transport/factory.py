"""From the `link` section of a bench to the link that it describes."""

from piezod.config.link import LinkConfig, ModbusTcpLink
from piezod.errors import ConfigurationError
from piezod.transport.link import Link
from piezod.transport.modbus import ModbusLink
from piezod.transport.modbus_tcp import TcpWire


def make_link(link: LinkConfig, load_cell: LinkConfig | None = None) -> Link:
    """Build the link; nothing is opened yet.

    Parameters
    ----------
    link
        Amplifier, and load cell if there is no other link to it.
    load_cell
        The load cell's own link.

    Raises
    ------
    ConfigurationError
        A register map or a template that cannot be exchanged.
    """
    if load_cell is not None or not isinstance(link, ModbusTcpLink):
        raise ConfigurationError("link.kind is not available yet")
    return ModbusLink(link, TcpWire(link))
