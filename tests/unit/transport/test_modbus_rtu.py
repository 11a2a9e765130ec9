"""An RTU wire: noise, echo, gaps between frames, and the errors of a serial port."""

import os
import subprocess
import sys
import time
import tty

import pytest

from piezod.errors import BusyError, UnreachableError
from piezod.runtime import descriptors as door
from piezod.transport import ExchangeResult, make_link
from tests.unit.transport.conftest import opened, rtu_config
from tests.unit.transport.garbled import bit_flipped
from tests.unit.transport.scripted import ScriptedPty, crc, descriptors, until_good


def test_noise_after_the_reply_is_discarded_and_counted(rtu):
    link, server = rtu
    server.once(lambda frame: [server.good(frame) + b"\x55\xaa"])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.stale_bytes == 2
    assert link.exchange(4.0) is ExchangeResult.OK


def test_the_command_echo_detects_a_reply_to_the_previous_command(rtu):
    link, server = rtu
    older = []
    server.answer = lambda frame, _number: [older.append(server.good(frame)) or older[-min(2, len(older))]]
    link.exchange(1.0)
    assert [link.exchange(float(volt)) for volt in (2, 3, 4)] == [ExchangeResult.ECHO_MISMATCH] * 3


def test_a_register_is_read_after_the_line_has_settled(rtu):
    link, server = rtu
    server.once(lambda _frame: [])
    assert link.exchange(1.0) is ExchangeResult.TIMEOUT
    assert link.read_register("identity") == 20570


def test_a_local_echo_of_the_request_gives_a_hint(rtu):
    link, server = rtu
    server.once(lambda frame: [bytes(frame), 0.001, server.good(frame)])
    assert link.exchange(3.0) is ExchangeResult.MALFORMED
    assert "local echo" in link.hint


def test_bad_checksums_in_a_row_hint_at_baudrate_and_parity(rtu):
    link, server = rtu
    server.answer = lambda frame, _number: bit_flipped(server.good(frame))
    for _ in range(4):
        assert link.exchange(3.0) is ExchangeResult.BAD_CRC
    assert link.hint == ""
    link.exchange(3.0)
    assert "check baudrate and parity" in link.hint
    server.answer = lambda frame, _number: [server.good(frame)]
    until_good(lambda: link.exchange(3.0))
    assert link.hint == ""


def test_the_error_of_a_locked_port_names_the_process():
    holder = "import serial, sys; p = serial.Serial(sys.argv[1], exclusive=True); print(flush=True); sys.stdin.read()"
    with ScriptedPty() as server:
        arguments = [sys.executable, "-c", holder, server.port]
        with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            with pytest.raises(BusyError, match=rf"{server.port} is held by process \d+ \("):
                make_link(rtu_config(server.port)).open()
            process.stdin.close()


def test_the_error_of_a_missing_port_names_the_adapter():
    with pytest.raises(UnreachableError, match="does not exist: is the adapter plugged in"):
        make_link(rtu_config("/dev/serial/by-id/none")).open()


def test_a_port_that_disappears_costs_no_processor_time_and_is_reopened_by_its_name(tmp_path):
    port = tmp_path / "by-id"
    with ScriptedPty() as first, ScriptedPty() as second:
        port.symlink_to(first.port)
        with opened(first, rtu_config(str(port), timeout_s=0.01)) as (link, _):
            until_good(lambda: link.exchange(1.0))
            first.__exit__()
            port.unlink()
            spent_s = time.process_time()
            results = {link.exchange(1.0) for _ in range(20) if not time.sleep(0.005)}
            assert results == {ExchangeResult.DISCONNECTED}
            assert time.process_time() - spent_s < 0.08
            port.symlink_to(second.port)
            until_good(lambda: link.exchange(9.0))
            assert second.bench.voltage_V == 9.0


def test_descriptors_stay_the_same_over_200_reopenings():
    with ScriptedPty() as server, opened(server, rtu_config(server.port)) as (link, _):
        before = descriptors()
        for _ in range(200):
            link._wire._port.close_and_settle(0.0)
            assert link._wire.ensure_open(0.0) is ExchangeResult.OK
        assert descriptors() == before


def test_a_request_that_the_port_accepts_in_parts_is_completed(rtu, monkeypatch):
    link, _ = rtu
    write = os.write
    ours = link._wire._port._descriptor
    monkeypatch.setattr(door, "write", lambda fd, data: write(fd, bytes(data[:3]) if fd == ours else data))
    assert link.exchange(3.0) is ExchangeResult.OK


def test_frames_are_separated_by_the_configured_gap():
    with ScriptedPty() as server, opened(server, rtu_config(server.port, silent_interval="fixed")) as (link, _):
        begun_s = time.monotonic()
        for _ in range(11):
            assert link.exchange(1.0) is ExchangeResult.OK
        assert time.monotonic() - begun_s > 10 * 0.00175


def test_bytes_received_before_opening_are_not_a_reply():
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        link = make_link(rtu_config(os.ttyname(slave), timeout_s=0.01))
        os.write(master, crc(b"\x01\x17\x0e" + bytes(14)))
        link.open()
        assert link.exchange(1.0) is ExchangeResult.TIMEOUT
        link.close()
    finally:
        os.close(master)
        os.close(slave)
