"""The device profiles against the manuals of the devices.

The tables are written from the manuals, independently of the YAML files; each table names its source.
The bytes are calculated by hand from register type and wiring. Only `struct` decodes them.
"""

import re
import struct
from pathlib import Path

import pytest

from piezod.config import BenchConfig, load_bench, read_document
from piezod.config.link import LineCommand, ModbusRtuLink, ModbusTcpLink, Register, Registers, SerialLineLink

CONFIG = Path(__file__).parents[2] / "config"
BENCHES = sorted(
    path for path in CONFIG.glob("*.yaml") if read_document(path).content.get("schema") == "piezod.bench/1"
)
DEVICES = ("advantech_adam_6024", "labjack_t7", "pi_e625", "thorlabs_mdt693b", "wago_750")

# LabJack: ljm_constants.json (AIN# from 0, DAC# from 1000, FLOAT32; PRODUCT_ID 60000; TEST 55100, UINT32, 1122867);
# "Getting Started [Direct Modbus TCP]": functions 3, 4, 6, 16, most significant word first.
_T7_LOAD_CELL = {
    "force": (0, 3, "float32", "ABCD"),
    "identity": (60000, 3, "float32", "ABCD"),
    "order_check": (55100, 3, "int32", "ABCD"),
}
_T7 = _T7_LOAD_CELL | {
    "voltage_setpoint": (1000, 16, "float32", "ABCD"),
    "voltage_readback": (2, 3, "float32", "ABCD"),
}
# Advantech: ADAM-6000 Series User Manual, B.2.4: AI0 40001, AI1 40002, AO0 40011; B.1.2: functions 3 and 6.
_ADAM_6024 = {
    "voltage_setpoint": (40011 - 40001, 6, "uint16", "AB"),
    "force": (40001 - 40001, 3, "uint16", "AB"),
    "voltage_readback": (40002 - 40001, 3, "uint16", "AB"),
}
# WAGO: 750-341, 4.2.4: inputs from 0x0000, outputs from 0x0200; 750-882 manual 1.5.0, 12.2.5.5: 0x2002, 0x2011, 0x2012.
_WAGO_750 = {
    "voltage_setpoint": (512, 23, "int16", "AB"),
    "force": (0, 23, "int16", "AB"),
    "voltage_readback": (1, 23, "int16", "AB"),
    "identity": (8210, 3, "uint16", "AB"),
    "map_version": (8209, 3, "uint16", "AB"),
    "order_check": (8194, 3, "uint16", "AB"),
}
MAPS = [
    ("labjack_t7", "link", _T7),
    ("advantech_adam_6024", "link", _ADAM_6024),
    ("wago_750", "link", _WAGO_750),
    ("pi_e625", "load_cell_link", _T7_LOAD_CELL),
    ("thorlabs_mdt693b", "load_cell_link", _T7_LOAD_CELL),
]

# Bytes on the wire, and the quantity at the bench.
WIRE = [
    ("labjack_t7", "link", "voltage_setpoint", "40 00 00 00", 60.0),  # 2 V at DAC0, gain 30
    ("labjack_t7", "link", "voltage_setpoint", "40 80 00 00", 120.0),  # 4 V
    ("labjack_t7", "link", "force", "40 20 00 00", 100.0),  # 2.5 V, 40 N/V
    ("labjack_t7", "link", "force", "bf 00 00 00", -20.0),  # -0.5 V
    ("labjack_t7", "link", "voltage_readback", "40 40 00 00", 60.0),  # 3 V, 20 V/V
    ("advantech_adam_6024", "link", "voltage_setpoint", "00 00", 0.0),
    ("advantech_adam_6024", "link", "voltage_setpoint", "03 33", 24.0),  # 819 of 4095: 2 V, gain 12
    ("advantech_adam_6024", "link", "voltage_setpoint", "0f ff", 120.0),  # 4095: 10 V
    ("advantech_adam_6024", "link", "force", "00 00", -400.0),  # -10 V, 40 N/V
    ("advantech_adam_6024", "link", "force", "99 99", 80.0),  # 39321 of 65535: 12 V of 20 V above -10 V
    ("advantech_adam_6024", "link", "force", "ff ff", 400.0),  # 10 V
    ("advantech_adam_6024", "link", "voltage_readback", "99 99", 40.0),  # 2 V, 20 V/V
    ("wago_750", "link", "voltage_setpoint", "00 00", 0.0),
    ("wago_750", "link", "voltage_setpoint", "7f ff", 150.0),  # 750-559: 0x7FFF is 10 V, gain 15
    ("wago_750", "link", "force", "7f ff", 400.0),  # 750-471: 0x7FFF is 10 V, 40 N/V
    ("wago_750", "link", "force", "80 01", -400.0),
    ("wago_750", "link", "voltage_readback", "7f ff", 200.0),
]
# Bytes in the identity registers of the right device.
EXPECTED = [
    ("labjack_t7", "link", "identity", "40 e0 00 00"),  # 7.0
    ("labjack_t7", "link", "order_check", "00 11 22 33"),
    ("pi_e625", "load_cell_link", "order_check", "00 11 22 33"),
    ("thorlabs_mdt693b", "load_cell_link", "order_check", "00 11 22 33"),
    ("wago_750", "link", "identity", "01 60"),  # 352
    ("wago_750", "link", "map_version", "02 ee"),  # 750
    ("wago_750", "link", "order_check", "12 34"),
]
# PI: E-816 commands end in a line feed (EPICS drvPIE816); Thorlabs: CR ends a command (guide TTN011225-D02, rev. H).
COMMANDS = [
    ("pi_e625", "set_voltage", b"SVA A 10.000\n"),
    ("pi_e625", "measure", b"VOL? A\n"),
    ("pi_e625", "identity", b"*IDN?\n"),
    ("thorlabs_mdt693b", "set_voltage", b"xvoltage=10.00\r"),
    ("thorlabs_mdt693b", "measure", b"xvoltage?\r"),
    ("thorlabs_mdt693b", "identity", b"vlimit?\r"),
]
READINGS = [
    ("pi_e625", "+0050.0000", 50.0),
    ("pi_e625", "A=-1.25", -1.25),
    ("pi_e625", " 1.5e+01 ", 15.0),
    ("thorlabs_mdt693b", "[ 45.50]", 45.5),
    ("thorlabs_mdt693b", ">[ 0.02]", 0.02),  # after the prompt of the previous command
    ("thorlabs_mdt693b", "*[37.50]", 37.5),
]
NO_READINGS = [
    ("pi_e625", ""),
    ("pi_e625", "50.0 50.0"),
    ("thorlabs_mdt693b", "CMD_NOT_DEFINED>"),
    ("thorlabs_mdt693b", "!"),
    ("thorlabs_mdt693b", "[ 45."),
]


def _bench(name: str) -> BenchConfig:
    return load_bench(CONFIG / f"{name}.yaml")


def _registers(name: str, link: str) -> Registers:
    found = getattr(_bench(name), link)
    assert isinstance(found, ModbusTcpLink | ModbusRtuLink)
    return found.registers


def _register(name: str, link: str, role: str) -> Register:
    register = getattr(_registers(name, link), role)
    assert isinstance(register, Register)
    return register


def _decode(register: Register, wire: str) -> float:
    raw = bytes.fromhex(wire)
    assert register.byte_order in ("AB", "ABCD")
    code = {"int16": ">h", "uint16": ">H", "int32": ">i", "float32": ">f"}[register.type]
    return struct.unpack(code, raw)[0] * register.scale + register.offset


def _line(name: str, role: str) -> tuple[SerialLineLink, LineCommand]:
    link = _bench(name).link
    assert isinstance(link, SerialLineLink)
    command = getattr(link, role)
    assert isinstance(command, LineCommand)
    return link, command


def test_every_device_has_a_profile():
    assert {path.stem for path in BENCHES} >= set(DEVICES)


@pytest.mark.parametrize("path", BENCHES, ids=lambda path: path.stem)
def test_every_bench_configuration_loads(path):
    assert load_bench(path).model == "model.yaml"


@pytest.mark.parametrize("name", DEVICES)
def test_the_name_of_a_profile_is_the_name_of_its_file(name):
    assert _bench(name).name == name


@pytest.mark.parametrize(("name", "link", "expected"), MAPS)
def test_the_registers_are_exactly_those_of_the_manual(name, link, expected):
    registers = _registers(name, link)
    found = {
        role: (register.address, register.function, register.type, register.byte_order)
        for role in Registers.model_fields
        if (register := getattr(registers, role)) is not None
    }
    assert found == expected


@pytest.mark.parametrize(("name", "link", "role", "wire", "value"), WIRE)
def test_bytes_on_the_wire_decode_to_the_quantity_at_the_bench(name, link, role, wire, value):
    assert _decode(_register(name, link, role), wire) == pytest.approx(value, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize(("name", "link", "role", "wire"), EXPECTED)
def test_the_expected_value_equals_the_bytes_of_the_device(name, link, role, wire):
    register = _register(name, link, role)
    assert _decode(register, wire) == register.expect


def test_a_t7_read_with_swapped_words_is_refused():
    assert _decode(_register("labjack_t7", "link", "order_check"), "22 33 00 11") == 573767697  # LabJack
    assert _register("labjack_t7", "link", "order_check").expect != 573767697


@pytest.mark.parametrize(("name", "role", "wire"), COMMANDS)
def test_command_lines_equal_those_of_the_manual(name, role, wire):
    link, command = _line(name, role)
    assert (command.send.format(voltage_V=10.0) + link.terminator).encode("ascii") == wire


@pytest.mark.parametrize(("name", "answer", "value"), READINGS)
def test_a_reply_contains_the_voltage(name, answer, value):
    match = re.fullmatch(_line(name, "measure")[1].reply, answer)
    assert match is not None
    assert float(match["voltage_readback_V"]) == value


@pytest.mark.parametrize(("name", "answer"), NO_READINGS)
def test_a_reply_without_a_voltage_does_not_match(name, answer):
    assert re.fullmatch(_line(name, "measure")[1].reply, answer) is None


@pytest.mark.parametrize("name", ["pi_e625", "thorlabs_mdt693b"])
def test_serial_ports_run_at_115200_8n1(name):
    link = _bench(name).link
    assert (link.baudrate, link.bytesize, link.parity, link.stopbits) == (115200, 8, "N", 1)


@pytest.mark.parametrize("name", ["pi_e625", "thorlabs_mdt693b"])
def test_the_lines_of_a_tick_take_less_than_half_its_period(name):
    bench = _bench(name)
    link, command = _line(name, "set_voltage")
    characters = len(command.send.format(voltage_V=100.0)) + len(link.measure.send) + 2 * len(link.terminator) + 16
    assert characters * link.bits_per_character / link.baudrate < bench.dt_s / 2


@pytest.mark.parametrize(
    ("name", "full_scale"),
    [("labjack_t7", 5.0), ("advantech_adam_6024", 4095), ("wago_750", 32767)],  # V; counts for 10 V
)
def test_the_voltage_range_lies_within_the_converter(name, full_scale):
    limits, register = _bench(name).limits, _register(name, "link", "voltage_setpoint")
    for voltage_V in (limits.voltage_min_V, limits.voltage_max_V):
        assert 0 <= (voltage_V - register.offset) / register.scale <= full_scale


@pytest.mark.parametrize("name", DEVICES)
def test_a_profile_describes_the_missing_heartbeat_and_watchdog(name):
    text = (CONFIG / f"{name}.yaml").read_text(encoding="utf-8")
    assert "#   heartbeat" in text
    assert re.search(r"#   watchdog.*permanently", text, re.DOTALL)
