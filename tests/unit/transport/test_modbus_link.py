"""A Modbus link over a valid wire: set point, echo, heartbeat, set-up registers and identity."""

import struct
import time

import pytest

from piezod.errors import ConfigurationError, IdentityError, TemporaryError
from piezod.transport import ExchangeResult, verify_identity
from tests.unit.transport.conftest import MODBUS_WIRES, connected
from tests.unit.transport.garbled import exception, overwritten, with_body
from tests.unit.transport.scripted import CLOSE, registers, until_good


def test_a_voltage_that_cannot_be_encoded_is_not_sent(tcp):
    link, server = tcp
    sent = len(server.bench.requests)
    assert link.exchange(1e39) is ExchangeResult.OUT_OF_RANGE
    assert len(server.bench.requests) == sent
    assert link.written_V == 1.0
    assert link.exchange(2.0) is ExchangeResult.OK


def test_the_written_voltage_equals_the_register_of_the_device(tcp):
    link, server = tcp
    assert link.exchange(1.0 / 3.0) is ExchangeResult.OK
    assert link.written_V == server.bench.voltage_V != 1.0 / 3.0


def test_a_poll_after_a_command_requires_its_echo(tcp):
    link, server = tcp
    assert link.poll() is ExchangeResult.OK
    server.bench.put(102, ">H", 999)
    assert link.poll() is ExchangeResult.ECHO_MISMATCH


def test_an_accepted_command_of_another_program_is_told_once_and_the_next_one_again(tcp):
    link, server = tcp
    server.bench.put(102, ">H", 999)
    assert link.poll() is ExchangeResult.ECHO_MISMATCH
    link.accept_foreign_command()
    assert [link.poll() for _ in range(3)] == [ExchangeResult.OK] * 3
    assert link.compare_command() is ExchangeResult.OK
    server.bench.put(102, ">H", 7)
    assert link.poll() is ExchangeResult.ECHO_MISMATCH
    assert link.exchange(1.0) is ExchangeResult.OK
    assert link.poll() is ExchangeResult.OK


def test_a_restarted_device_is_refused_by_exchange_and_accepted_by_poll(tcp):
    link, server = tcp
    server.bench.heartbeat = 500
    assert link.exchange(1.0) is ExchangeResult.OK
    server.once(lambda _frame: [CLOSE])
    link.exchange(1.0)
    server.bench.heartbeat = 3
    assert ExchangeResult.HEARTBEAT_STOOD in [link.exchange(1.0) for _ in range(80) if not time.sleep(0.001)]
    server.once(lambda _frame: [CLOSE])
    link.poll()
    server.bench.heartbeat = 3
    until_good(link.poll)


def test_set_up_registers_are_read_and_written(tcp):
    link, server = tcp
    link.write_register("watchdog_ms", 150.0)
    assert server.bench.get(110, ">H") == 150
    assert link.read_register("watchdog_ms") == 150.0


def test_a_value_that_does_not_fit_its_register_is_refused(tcp):
    link, _ = tcp
    with pytest.raises(ConfigurationError, match=r"registers\.watchdog_ms: 70000 cannot be encoded"):
        link.write_register("watchdog_ms", 70000.0)


@pytest.mark.parametrize(("code", "error"), [(1, ConfigurationError), (2, ConfigurationError), (6, TemporaryError)])
def test_the_error_of_an_exception_in_set_up_names_register_and_address(tcp, code, error):
    link, server = tcp
    server.once(lambda frame: with_body("tcp", exception(code))(server.good(frame)))
    with pytest.raises(error, match=rf"registers\.watchdog_ms at address 110: exception {code}"):
        link.read_register("watchdog_ms")


def test_another_identity_is_refused_with_both_values(tcp):
    link, server = tcp
    server.bench.put(0, ">H", 7)
    with pytest.raises(IdentityError, match=r"registers\.identity at address 0 is 7, expected 20570"):
        verify_identity(link)


def test_another_word_order_is_refused_with_the_order_of_the_device(tcp):
    link, server = tcp
    big = struct.pack(">f", 1234.5)
    server.bench.memory[4:8] = big[2:] + big[:2]
    with pytest.raises(IdentityError, match="sends it in order CDAB, configured is ABCD; set order: CDAB"):
        verify_identity(link)


def test_the_code_of_the_last_exception_is_stored(tcp):
    link, server = tcp
    server.once(lambda frame: with_body("tcp", exception(6))(server.good(frame)))
    link.exchange(1.0)
    assert link.last_exception == 6


@pytest.mark.parametrize("wire", MODBUS_WIRES)
def test_a_single_register_write_requires_its_value_in_the_reply(wire):
    single = registers(6, 3, without=("command_sequence", "command_echo"))
    single["voltage_setpoint"] |= {"type": "int16", "scale": 0.01}
    with connected(wire, registers=single) as (link, server):
        assert link.exchange(12.344) is ExchangeResult.OK
        assert link.exchange(7.5) is ExchangeResult.OK
        assert server.bench.get(100, ">h") == 750
        assert link.written_V == pytest.approx(7.5)
        server.once(lambda frame: with_body(wire, overwritten(4, b"\7"))(server.good(frame)))
        assert link.exchange(3.0) is ExchangeResult.WRONG_COUNT
