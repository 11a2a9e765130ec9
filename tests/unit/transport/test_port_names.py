"""Serial ports are known by their names, and a missing one brings the question that fits."""

import re
from pathlib import Path

import pytest

from piezod.config.link import ModbusRtuLink
from piezod.errors import UnreachableError
from piezod.transport import make_link
from piezod.transport.port_names import BUILT_IN, SERVICE_PORTS, is_allowed_in_service, port_kind


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


@pytest.mark.parametrize(
    ("port", "is_allowed"),
    [
        ("/dev/ttyAMA0", True),
        ("/dev/ttyUSB12", True),
        ("/dev/ttymxc2", False),
        ("/dev/ttyTHS1", False),
        ("/dev/ttyXRUSB0", False),
        ("/dev/ttySAC0", False),
        ("/dev/pts/3", True),
    ],
)
def test_the_ports_that_the_service_may_not_open_are_known(port, is_allowed):
    assert is_allowed_in_service(port) == is_allowed


def test_a_link_to_a_port_is_followed(tmp_path):
    link = tmp_path / "usb-Vendor_Adapter"
    link.symlink_to("/dev/ttymxc2")
    assert not is_allowed_in_service(str(link))


def test_the_known_ports_are_those_of_the_unit():
    unit = (Path(__file__).parents[3] / "systemd" / "piezod.service").read_text(encoding="utf-8")
    assert re.findall(r"(?m)^DeviceAllow=char-(tty\w+) rw$", unit) == list(SERVICE_PORTS)
