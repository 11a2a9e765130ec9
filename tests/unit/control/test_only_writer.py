"""The voltage register has one writer, directly behind the limiter."""

import ast
from pathlib import Path

import pytest

import piezod
from piezod.config.link import ModbusTcpLink
from piezod.errors import ConfigurationError
from piezod.transport import make_link

PACKAGE = Path(piezod.__file__).parent
SET_POINT = {"address": 100, "function": 16, "unit": "V"}


def calls_of(method):
    """(file, enclosing source line) of every call of `method` in the package, without the delegation between links."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        found += [
            (path.relative_to(PACKAGE).as_posix(), ast.get_source_segment(source, node))
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == method
        ]
    return found


def test_voltages_are_written_at_one_place_and_through_the_limiter():
    outside_links = [(path, call) for path, call in calls_of("exchange") if not path.startswith("transport/")]
    assert outside_links == [
        ("commissioning/proof/links.py", "self._link.exchange(voltage_V)"),  # a changed link to its own
        ("control/voltage_writer.py", "link.exchange(limiter.limit(planned_V, change_V, share))"),
    ]


def test_links_pass_on_voltages_unchanged():
    inside_links = {call for path, call in calls_of("exchange") if path.startswith("transport/")}
    assert inside_links == {
        "self._amplifier.exchange(voltage_V)",  # a pair to its amplifier
    }


def test_no_set_up_write_names_the_set_point():
    roles = {call.partition("write_register(")[2].partition(",")[0] for _, call in calls_of("write_register")}
    assert roles == {'"watchdog_ms"', '"virtual_tick_us"', "role"}


@pytest.mark.parametrize("role", ["voltage_setpoint", "command_sequence"])
def test_a_set_up_write_to_a_register_of_the_tick_is_refused(role):
    registers = {
        "voltage_setpoint": SET_POINT,
        "command_sequence": {"address": 102, "function": 16, "type": "uint16"},
    }
    config = {"kind": "modbus_tcp", "host": "127.0.0.1", "port": 1, "registers": registers}
    link = make_link(ModbusTcpLink.model_validate(config))
    with pytest.raises(ConfigurationError, match="written only in the tick"):
        link.write_register(role, 1.0)
