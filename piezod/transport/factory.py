"""From the `link` section of a bench to the link that it describes."""

from piezod.config.link import LinkConfig, ModbusRtuLink, ModbusTcpLink, SerialLineLink
from piezod.transport.line_template import LineTemplate
from piezod.transport.link import Link
from piezod.transport.modbus import ModbusLink
from piezod.transport.modbus_rtu import RtuWire
from piezod.transport.modbus_tcp import TcpWire
from piezod.transport.pair import PairLink
from piezod.transport.registers import RegisterCodec
from piezod.transport.serial_line import SerialLineDevice


def make_link(link: LinkConfig, load_cell: LinkConfig | None = None) -> Link:
    """Build the link; nothing is opened yet.

    Parameters
    ----------
    link
        The amplifier, and the load cell too unless it has a link of its own.
    load_cell
        The load cell's own link.

    Raises
    ------
    ConfigurationError
        A register map, a template or a pattern that cannot be exchanged.
    """
    if load_cell is None:
        return _single(link)
    return PairLink(_single(link), _single(load_cell))


def check_encodable(link: LinkConfig, low_V: float, high_V: float) -> None:
    """Refuse voltage limits that cannot be put on the wire.

    Parameters
    ----------
    link
        The amplifier's link.
    low_V, high_V
        The range that will be commanded [V].

    Raises
    ------
    ConfigurationError
        Names the limit, and what the register or the line can carry.
    """
    if isinstance(link, SerialLineLink):
        if link.set_voltage is not None:
            LineTemplate(link.set_voltage.send, "voltage_V", link.terminator, "link.set_voltage.send")
    elif link.registers.voltage_setpoint is not None:
        RegisterCodec(link.registers.voltage_setpoint).check_encodable(low_V, high_V, "link.registers.voltage_setpoint")


def _single(config: LinkConfig) -> Link:
    if isinstance(config, ModbusTcpLink):
        return ModbusLink(config, TcpWire(config))
    if isinstance(config, ModbusRtuLink):
        return ModbusLink(config, RtuWire(config))
    return SerialLineDevice(config)
