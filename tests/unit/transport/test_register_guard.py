"""Identity at every connection, and the registers that are read again while voltages are written."""

import time

import pytest

from piezod.errors import IdentityError
from piezod.transport import ExchangeResult, make_link
from piezod.transport.pair import PairLink
from tests.unit.transport.conftest import TIMEOUT_S, WIRES, connected, tcp_config
from tests.unit.transport.scripted import CLOSE, ScriptedTcp, registers, until_good

OK, WRONG, CHANGED = ExchangeResult.OK, ExchangeResult.WRONG_DEVICE, ExchangeResult.SETTING_CHANGED


def reconnect_to_another_device(link, server):
    server.once(lambda _frame: [CLOSE])
    assert link.exchange(2.0) is ExchangeResult.DISCONNECTED
    server.bench.put(0, ">H", 7)


@pytest.mark.parametrize("act", ["exchange", "poll"])
def test_another_device_after_a_reconnection_gets_no_voltage(tcp, act):
    link, server = tcp
    reconnect_to_another_device(link, server)
    results = {link.exchange(5.0) if act == "exchange" else link.poll() for _ in range(200)}
    assert WRONG in results
    assert OK not in results
    assert server.bench.voltage_V == 1.0


def test_the_first_exchange_of_an_opened_link_verifies_the_identity():
    with connected("tcp") as (link, server):
        server.bench.put(0, ">H", 7)
        assert link.exchange(5.0) is WRONG
        assert server.bench.voltage_V == 0.0


def test_the_configured_device_is_accepted_again_on_its_own_connection(tcp):
    link, server = tcp
    reconnect_to_another_device(link, server)
    until_wrong = [link.exchange(5.0) for _ in range(200)]
    assert WRONG in until_wrong
    server.bench.put(0, ">H", 20570)
    assert OK in [link.exchange(5.0) for _ in range(5)]


def test_a_setting_is_not_written_to_another_device(tcp):
    link, server = tcp
    reconnect_to_another_device(link, server)
    with pytest.raises(IdentityError, match="is 7, expected 20570"):
        link.write_register("watchdog_ms", 150.0)
    assert server.bench.get(110, ">H") == 0


def test_a_changed_setting_is_reported_and_written_again(tcp):
    link, server = tcp
    link.write_register("watchdog_ms", 150.0)
    assert [link.supervise(1.0) for _ in range(2 * link.supervised)] == [OK] * (2 * link.supervised)
    server.bench.put(110, ">H", 0)
    found = [link.supervise(1.0) for _ in range(link.supervised)]
    assert found.count(CHANGED) == 1
    assert server.bench.get(110, ">H") == 150
    assert CHANGED not in [link.supervise(1.0) for _ in range(link.supervised)]


def refuses_writes(server):
    """The device answers each write of the voltage with exception 4, and each read as it should."""
    refusal = lambda frame: [frame[:5] + bytes([3, frame[6], frame[7] | 0x80, 4])]  # noqa: E731
    server.answer = lambda frame, _number: [server.good(frame)] if frame[7] == 3 else refusal(frame)


def test_a_command_that_the_device_refused_is_not_one_of_another_program(tcp):
    link, server = tcp
    refuses_writes(server)
    assert link.exchange(2.0) is ExchangeResult.DEVICE_EXCEPTION
    assert link.compare_command() is OK
    assert [link.supervise(1.0) for _ in range(2 * link.supervised)] == [OK] * (2 * link.supervised)


def test_a_command_of_another_program_is_found_again_after_a_refusal(tcp):
    link, server = tcp
    good = server.answer
    refuses_writes(server)
    link.exchange(2.0)
    server.answer = good
    assert link.exchange(2.0) is OK
    assert link.compare_command() is OK
    server.bench.put(102, ">H", server.bench.get(102, ">H") + 1)
    assert link.compare_command() is ExchangeResult.FOREIGN_COMMAND


def test_a_changed_setting_that_the_device_refuses_to_take_back_is_tried_again_at_once(tcp):
    link, server = tcp
    link.write_register("watchdog_ms", 150.0)
    server.bench.put(110, ">H", 5000)
    busy = lambda frame: [frame[:5] + bytes([3, frame[6], frame[7] | 0x80, 6])]  # noqa: E731
    server.answer = lambda frame, _number: [server.good(frame)] if frame[7] == 3 else busy(frame)
    found = [link.supervise(1.0) for _ in range(link.supervised)]
    assert found[-1] is CHANGED
    assert server.bench.get(110, ">H") == 5000
    server.answer = lambda frame, _number: [server.good(frame)]
    assert link.supervise(1.0) is CHANGED
    assert server.bench.get(110, ">H") == 150


def test_an_identity_that_changes_on_the_same_connection_stops_every_write(tcp):
    link, server = tcp
    server.bench.put(0, ">H", 7)
    assert WRONG in [link.supervise(1.0) for _ in range(link.supervised)]
    assert link.exchange(9.0) is WRONG
    assert server.bench.voltage_V == 1.0


def test_neighbouring_registers_of_identity_are_one_read():
    adjacent = registers(map_version={"address": 1, "function": 3, "type": "uint16", "expect": 1})
    with connected("tcp", registers=adjacent) as (link, server):
        server.bench.put(1, ">H", 1)
        sent = len(server.bench.requests)
        assert link.exchange(1.0) is OK
        assert len(server.bench.requests) - sent == 2


def slow_identity(server, pause_s):
    """Answers every request, reads of the identity after a pause [s]."""
    server.answer = lambda frame, _number: [pause_s, server.good(frame)] if frame[7] == 3 else [server.good(frame)]


def test_a_slow_comparison_continues_in_the_next_tick_on_the_same_connection(tcp):
    link, server = tcp
    server.once(lambda _frame: [CLOSE])
    link.exchange(2.0)
    connections, sent = server.connections, len(server.bench.requests)
    slow_identity(server, 0.6 * TIMEOUT_S)
    results = until_good(lambda: link.exchange(3.0))
    assert results.count(ExchangeResult.UNVERIFIED) == 2  # identity and byte order are two reads
    assert set(results) <= {OK, ExchangeResult.UNVERIFIED, ExchangeResult.DISCONNECTED}
    assert server.connections == connections + 1
    assert len(server.bench.requests) - sent == 3


def test_a_poll_accepts_a_restarted_counter_also_when_the_comparison_takes_two_ticks(tcp):
    link, server = tcp
    server.bench.heartbeat = 500
    assert link.exchange(1.0) is OK
    server.once(lambda _frame: [CLOSE])
    link.poll()
    server.bench.heartbeat = 3
    slow_identity(server, 0.6 * TIMEOUT_S)
    assert ExchangeResult.UNVERIFIED in until_good(link.poll)


def test_supervision_before_a_new_connection_is_verified_reads_nothing():
    with connected("tcp") as (link, server):
        sent = len(server.bench.requests)
        assert link.supervise(1.0) is ExchangeResult.UNVERIFIED
        assert len(server.bench.requests) == sent


def test_a_line_device_that_answers_another_name_twice_gets_no_voltage(line):
    link, server = line
    server.answer = lambda frame, _number: [b"other\n"] if frame.startswith(b"ID") else [server.good(frame)]
    link._port.close_lost()
    results = []
    while WRONG not in results and len(results) < 1000:
        results.append(link.exchange(7.0))
        time.sleep(0.001)
    assert WRONG in results
    assert OK not in results
    assert server.bench.voltage_V == 1.0


def test_a_line_device_gets_its_watchdog_again_after_the_port_returns(line):
    link, server = line
    link.write_register("watchdog_ms", 150.0)
    link._port.close_lost()
    server.bench.requests.clear()
    until_good(lambda: link.exchange(1.0))
    assert b"DOG 150\n" in server.bench.requests
    assert server.bench.requests.index(b"ID\n") < server.bench.requests.index(b"SET 1.000\n")


def test_a_line_device_that_acknowledges_another_watchdog_time_is_reported(line):
    link, server = line
    link.write_register("watchdog_ms", 150.0)
    server.answer = lambda frame, _number: [b"DOG 0\n"] if frame.startswith(b"DOG") else [server.good(frame)]
    assert CHANGED in [link.supervise(1.0) for _ in range(link.supervised)]


@pytest.fixture
def pair():
    with ScriptedTcp() as amplifier, ScriptedTcp() as cell:
        cell.bench.sample()
        no_force = registers(without=("force",))
        no_voltage = registers(read=3, without=("voltage_setpoint", "command_sequence", "command_echo"))
        link = PairLink(
            make_link(tcp_config(amplifier.port, registers=no_force)),
            make_link(tcp_config(cell.port, registers=no_voltage)),
        )
        link.open()
        assert link.exchange(1.0) is OK
        yield link, amplifier, cell
        link.close()


def test_a_pair_confirms_the_output_of_its_amplifier_when_the_load_cell_is_silent(pair):
    link, amplifier, cell = pair
    cell.answer = lambda _frame, _number: []
    assert link.exchange(2.0) is ExchangeResult.TIMEOUT
    assert link.output_confirmed
    assert amplifier.bench.voltage_V == 2.0
    amplifier.answer = lambda _frame, _number: []
    assert link.exchange(3.0) is ExchangeResult.TIMEOUT
    assert not link.output_confirmed


def test_a_pair_reads_what_both_have_from_the_amplifier_and_the_force_from_the_load_cell(pair):
    link, amplifier, cell = pair
    amplifier.bench.put(110, ">H", 150)
    cell.bench.put(110, ">H", 70)
    assert link.read_register("watchdog_ms") == 150.0
    sent = len(amplifier.bench.requests)
    link.read_register("force")
    assert len(amplifier.bench.requests) == sent


def test_a_pair_names_the_device_that_is_another(pair):
    link, amplifier, cell = pair
    cell.bench.put(0, ">H", 7)
    found = [link.supervise(1.0) for _ in range(2 * link.supervised)]
    assert ExchangeResult.WRONG_LOAD_CELL in found
    assert WRONG not in found
    assert link.exchange(2.0) is ExchangeResult.WRONG_LOAD_CELL
    amplifier.bench.put(0, ">H", 7)
    cell.bench.put(0, ">H", 20570)
    assert link.exchange(2.0) is OK
    assert WRONG in [link.supervise(1.0) for _ in range(2 * link.supervised)]


def test_a_pair_reads_the_registers_of_its_amplifier_before_those_of_its_load_cell(pair):
    link, amplifier, cell = pair
    asked = []
    for name, device in (("amplifier", amplifier), ("cell", cell)):
        device.answer = lambda frame, _number, name=name, device=device: asked.append(name) or [device.good(frame)]
    of_amplifier = link._amplifier.supervised
    assert of_amplifier > 1
    assert [link.supervise(1.0) for _ in range(link.supervised)] == [OK] * link.supervised
    assert asked == ["amplifier"] * of_amplifier + ["cell"] * (link.supervised - of_amplifier)


@pytest.mark.parametrize("wire", WIRES)
def test_supervision_never_raises_and_ends_at_its_time_limit(wire):
    with connected(wire) as (link, server):
        assert link.exchange(1.0) is OK
        server.answer = lambda _frame, _number: []
        for _ in range(3):
            assert link.supervise(0.01) is not OK
