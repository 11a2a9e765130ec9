"""Creation of a link from the `link` section of a bench configuration."""

from piezod.config.link import LinkConfig, ModbusRtuLink, ModbusTcpLink, RtuOverTcpLink, SerialLineLink
from piezod.transport.line_template import LineTemplate
from piezod.transport.link import Link
from piezod.transport.modbus import ModbusLink
from piezod.transport.modbus_rtu import RtuWire
from piezod.transport.modbus_tcp import TcpWire
from piezod.transport.pair import PairLink
from piezod.transport.registers import RegisterCodec
from piezod.transport.serial_line import SerialLineDevice


def make_link(link: LinkConfig, load_cell: LinkConfig | None = None) -> Link:
    """Create the link; the connection is not yet opened.

    Parameters
    ----------
    link
        Link of the amplifier; also of the load cell if `load_cell` is None.

    Raises
    ------
    ConfigurationError
        The register map, a line template or a reply pattern is invalid.
    """
    if load_cell is None:
        return _single(link)
    return PairLink(_single(link), _single(load_cell))


def check_encodable(link: LinkConfig, low_V: float, high_V: float) -> None:
    """Check that the link can transmit every voltage within the limits.

    Parameters
    ----------
    low_V, high_V
        Range of commanded voltages [V].

    Raises
    ------
    ConfigurationError
        A limit lies outside the range of the register, or the line template is invalid.
    """
    if isinstance(link, SerialLineLink):
        if link.set_voltage is not None:
            LineTemplate(link.set_voltage.send, "voltage_V", link.terminator, "link.set_voltage.send")
    elif link.registers.voltage_setpoint is not None:
        RegisterCodec(link.registers.voltage_setpoint).check_encodable(low_V, high_V, "link.registers.voltage_setpoint")


def _single(config: LinkConfig) -> Link:
    if isinstance(config, ModbusTcpLink):
        return ModbusLink(config, TcpWire(config))
    if isinstance(config, ModbusRtuLink | RtuOverTcpLink):
        return ModbusLink(config, RtuWire(config))
    return SerialLineDevice(config)
