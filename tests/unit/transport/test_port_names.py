"""Serial ports are known by their names, and a missing one brings the question that fits."""

import pytest

from piezod.config.link import ModbusRtuLink
from piezod.errors import UnreachableError
from piezod.transport import make_link
from piezod.transport.port_names import BUILT_IN, port_kind


@pytest.mark.parametrize(
    ("port", "kind"),
    [
        ("/dev/ttyAMA0", BUILT_IN),
        ("/dev/ttyS4", BUILT_IN),
        ("/dev/ttyACM1", "USB device with a serial interface of its own"),
        ("/dev/ttyUSB12", "USB adapter"),
        ("/dev/ttySomething", ""),
        ("/dev/pts/3", ""),
    ],
)
def test_a_port_is_known_by_its_name(port, kind):
    assert port_kind(port) == kind


@pytest.mark.parametrize(("port", "says"), [("/dev/ttyAMA77", "enabled on the board"), ("/dev/ttyUSB77", "plugged in")])
def test_a_missing_port_brings_the_question_that_fits(port, says):
    link = make_link(ModbusRtuLink.model_validate({"kind": "modbus_rtu", "port": port, "registers": {}}))
    with pytest.raises(UnreachableError, match=says):
        link.open()
