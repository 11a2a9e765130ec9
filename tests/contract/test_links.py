"""Properties of every link, for all kinds of device and wire."""

import gc
import sys
import time
from collections import deque

import pytest

from piezod.errors import ConfigurationError
from piezod.transport import ExchangeResult, Link, Reading, make_link, verify_identity
from tests.benches.in_process_link import InProcessLink
from tests.unit.transport.conftest import WIRES, connected, gateway_config, line_config, rtu_config, tcp_config
from tests.unit.transport.scripted import (
    Bench,
    ScriptedGateway,
    ScriptedLine,
    ScriptedPty,
    ScriptedTcp,
    registers,
    snapshot,
    until_good,
)


class InProcessDevice:
    """A device object that can be switched to silent."""

    def __init__(self, bench):
        self.bench, self.silent = bench, False

    def exchange(self, voltage_V):
        if self.silent:
            return ExchangeResult.TIMEOUT
        if voltage_V is not None:
            self.bench.put(100, ">f", voltage_V)
        self.bench.sample()
        reading = Reading()
        reading.force_N = self.bench.get(200, ">f")
        reading.voltage_readback_V = self.bench.voltage_V
        reading.heartbeat = self.bench.heartbeat
        return reading


class Subject:
    """One link, its bench, and a function that silences the device."""

    def __init__(self, link, bench, silence):
        self.link, self.bench, self.silence = link, bench, silence


def silenced(server):
    def silence():
        server.answer = lambda _frame, _number: []

    return silence


def modbus(server_class, make_config, write, read):
    server = server_class()
    link = make_link(make_config(server.port, registers=registers(write, read)))
    return [server], Subject(link, server.bench, silenced(server))


def pair():
    amplifier, load_cell = ScriptedLine(), ScriptedTcp()
    load_cell.bench = amplifier.bench
    no_force = {"measure": {"send": "GET", "reply": r"F=\S+ V=(?P<voltage_readback_V>\S+) .*"}}
    cell = registers(read=3, without=("voltage_setpoint", "command_sequence", "command_echo", "voltage_readback"))
    link = make_link(line_config(amplifier.port, **no_force), tcp_config(load_cell.port, registers=cell))
    return [amplifier, load_cell], Subject(link, amplifier.bench, silenced(load_cell))


def by_lines():
    server = ScriptedLine()
    return [server], Subject(make_link(line_config(server.port)), server.bench, silenced(server))


def in_process():
    device = InProcessDevice(Bench())

    def silence():
        device.silent = True

    return [], Subject(InProcessLink(device, {"watchdog_ms": 0.0}), device.bench, silence)


LINKS = {
    "tcp, function 23": lambda: modbus(ScriptedTcp, tcp_config, 23, 23),
    "tcp, functions 16 and 3": lambda: modbus(ScriptedTcp, tcp_config, 16, 3),
    "tcp, functions 16 and 4": lambda: modbus(ScriptedTcp, tcp_config, 16, 4),
    "rtu, function 23": lambda: modbus(ScriptedPty, rtu_config, 23, 23),
    "rtu, functions 16 and 3": lambda: modbus(ScriptedPty, rtu_config, 16, 3),
    "gateway, function 23": lambda: modbus(ScriptedGateway, gateway_config, 23, 23),
    "gateway, functions 16 and 3": lambda: modbus(ScriptedGateway, gateway_config, 16, 3),
    "lines": by_lines,
    "lines and tcp": pair,
    "in process": in_process,
}


@pytest.fixture(params=LINKS)
def subject(request):
    servers, subject = LINKS[request.param]()
    for server in servers:
        server.__enter__()
    subject.link.open()
    try:
        yield subject
    finally:
        subject.link.close()
        for server in servers:
            server.__exit__()


def test_an_exchange_writes_the_voltage_and_reads_its_force(subject):
    for voltage_V in (1.0, 2.5, -3.0):
        assert subject.link.exchange(voltage_V) is ExchangeResult.OK
        assert subject.bench.voltage_V == subject.link.written_V == voltage_V
        assert subject.link.reading.force_N == 2.0 * voltage_V
        assert subject.link.reading.voltage_readback_V == voltage_V


def test_the_reading_stays_the_same_object(subject):
    reading = subject.link.reading
    subject.link.exchange(1.0)
    assert subject.link.reading is reading


def test_polling_reads_and_writes_nothing(subject):
    subject.link.exchange(2.0)
    written_V = subject.link.written_V
    assert subject.link.poll() is ExchangeResult.OK
    assert subject.bench.voltage_V == subject.link.written_V == written_V


def test_a_voltage_that_is_not_finite_reaches_no_device(subject):
    subject.link.exchange(2.0)
    sent = len(subject.bench.requests)
    for voltage_V in (float("nan"), float("inf"), float("-inf")):
        assert subject.link.exchange(voltage_V) is ExchangeResult.OUT_OF_RANGE
    assert subject.bench.voltage_V == subject.link.written_V == 2.0
    assert len(subject.bench.requests) == sent


def test_a_silent_device_costs_a_bounded_time_and_leaves_the_reading(subject):
    subject.link.exchange(2.0)
    before = snapshot(subject.link.reading)
    subject.silence()
    begun_s = time.monotonic()
    assert subject.link.exchange(3.0) is ExchangeResult.TIMEOUT
    assert time.monotonic() - begun_s < 1.0
    assert snapshot(subject.link.reading) == before


def test_every_exchange_is_counted_by_its_result(subject):
    for voltage_V in (1.0, float("nan"), 2.0):
        subject.link.exchange(voltage_V)
    subject.link.poll()
    assert len(subject.link.counts) == len(ExchangeResult)
    assert subject.link.counts[ExchangeResult.OK] == 3
    assert subject.link.counts[ExchangeResult.OUT_OF_RANGE] == 1


def test_a_link_can_be_closed_twice_and_opened_again(subject):
    subject.link.close()
    subject.link.close()
    subject.link.open()
    until_good(lambda: subject.link.exchange(4.0))
    assert subject.bench.voltage_V == 4.0


def test_the_watchdog_time_is_written_and_read_back(subject):
    if subject.link.has("watchdog_ms"):
        subject.link.write_register("watchdog_ms", 120.0)
        assert subject.link.read_register("watchdog_ms") == 120.0


def test_reading_a_role_that_the_device_lacks_is_an_error_with_the_role(subject):
    assert not subject.link.has("virtual_time")
    with pytest.raises(ConfigurationError, match="virtual_time"):
        subject.link.read_register("virtual_time")


def test_identity_is_verified_where_it_is_configured(subject):
    verify_identity(subject.link)
    assert subject.link.poll() is ExchangeResult.OK


def test_a_link_describes_itself(subject):
    link: Link = subject.link
    assert link.description
    assert link.hint == ""
    assert link.last_exception == 0
    assert link.stale_bytes >= 0


def test_exchanges_do_not_accumulate_memory(subject):
    exchange = subject.link.exchange
    subject.bench.requests = deque(maxlen=4)
    for _ in range(50):
        exchange(1.0)
    gc.collect()
    before = sys.getallocatedblocks()
    for _ in range(200):
        exchange(1.0)
    assert sys.getallocatedblocks() - before < 100


@pytest.mark.parametrize("wire", WIRES)
def test_an_exchange_ends_at_its_time_limit(wire):
    with connected(wire, timeout_s=5.0) as (link, server):
        assert link.exchange(1.0) is ExchangeResult.OK
        link.time_limit_s = 0.01
        server.answer = lambda _frame, _number: []
        begun_s = time.monotonic()
        assert link.exchange(2.0) is ExchangeResult.TIMEOUT
        assert time.monotonic() - begun_s < 2.0


@pytest.mark.parametrize("wire", WIRES)
def test_a_request_that_is_already_late_is_not_sent(wire):
    with connected(wire) as (link, server):
        assert link.exchange(1.0) is ExchangeResult.OK
        link.time_limit_s, sent = 0.0, len(server.bench.requests)
        assert link.exchange(2.0) is not ExchangeResult.OK
        time.sleep(0.05)
        assert len(server.bench.requests) == sent
        assert server.bench.voltage_V == 1.0
