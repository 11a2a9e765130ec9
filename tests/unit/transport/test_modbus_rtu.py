import os
import random
import struct
import subprocess
import sys
import time
import tty

import pytest

from piezod.errors import BusyError, UnreachableError
from piezod.transport import ExchangeResult, make_link
from tests.unit.transport.conftest import TIMEOUT_S, opened, rtu_config, tcp_config
from tests.unit.transport.scripted import ScriptedPty, ScriptedTcp, crc, descriptors, registers, snapshot, until_good

DATA = 3  # the registers begin there: unit, function, byte count


def patched(at, value):
    """Other bytes, and the checksum that belongs to them."""

    def change(reply):
        changed = bytearray(reply[:-2])
        changed[at : at + len(value)] = value
        return [crc(bytes(changed))]

    return change


def resized(registers_more):
    def change(reply):
        data = reply[DATA:-2] + b"\0\0" * registers_more if registers_more > 0 else reply[DATA : 2 * registers_more - 2]
        return [crc(reply[:2] + bytes((len(data),)) + data)]

    return change


def flipped(reply):
    return [reply[:5] + bytes((reply[5] ^ 4,)) + reply[6:]]


GARBLED = {
    "a bit flipped": (flipped, ExchangeResult.BAD_CRC),
    "another unit": (patched(0, b"\2"), ExchangeResult.WRONG_UNIT),
    "another function": (patched(1, b"\3"), ExchangeResult.WRONG_FUNCTION),
    "one register more": (resized(1), ExchangeResult.WRONG_COUNT),
    "one register fewer": (resized(-1), ExchangeResult.WRONG_COUNT),
    "byte count above the payload": (patched(2, b"\x10"), ExchangeResult.WRONG_COUNT),
    "odd byte count": (patched(2, b"\x0d"), ExchangeResult.WRONG_COUNT),
    "exception 2": (lambda reply: [crc(bytes((reply[0], reply[1] | 0x80, 2)))], ExchangeResult.DEVICE_EXCEPTION),
    "force not a number": (patched(DATA, struct.pack(">f", float("nan"))), ExchangeResult.NOT_FINITE),
    "force above high": (patched(DATA, struct.pack(">f", 1000.5)), ExchangeResult.OUT_OF_RANGE),
    "heartbeat as before": (patched(DATA + 8, struct.pack(">H", 1)), ExchangeResult.HEARTBEAT_STOOD),
    "echo of the command before": (patched(DATA + 10, struct.pack(">H", 1)), ExchangeResult.ECHO_MISMATCH),
    "noise before": (lambda reply: [b"\xff\x00", reply], ExchangeResult.BAD_CRC),
    "half a reply": (lambda reply: [reply[:9]], ExchangeResult.TIMEOUT),
    "nothing": (lambda _reply: [], ExchangeResult.TIMEOUT),
}


@pytest.mark.parametrize("case", GARBLED)
def test_of_a_garbled_reply_nothing_is_used_and_the_next_is_good(rtu, case):
    link, server = rtu
    change, expected = GARBLED[case]
    before = snapshot(link.reading)
    server.once(lambda frame: change(server.good(frame)))
    assert link.exchange(7.0) is expected
    assert snapshot(link.reading) == before
    until_good(lambda: link.exchange(8.0))
    assert link.reading.force_N == 16.0


def test_a_reply_in_single_bytes_is_accepted(rtu):
    link, server = rtu
    server.once(lambda frame: [part for byte in server.good(frame) for part in (bytes((byte,)), 0.0005)])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.reading.force_N == 6.0


def test_noise_after_the_reply_is_discarded_and_counted(rtu):
    link, server = rtu
    server.once(lambda frame: [server.good(frame) + b"\x55\xaa"])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.stale_bytes == 2
    assert link.exchange(4.0) is ExchangeResult.OK


@pytest.mark.parametrize("delay", [1.2, 1.6, 1.9])
def test_a_late_reply_is_never_taken_for_the_next(delay):
    with ScriptedPty() as server:
        config = rtu_config(server.port, registers=registers(without=("heartbeat", "command_echo", "command_sequence")))
        with opened(server, config) as (link, _):
            server.once(lambda frame: [delay * TIMEOUT_S, server.good(frame)])
            assert link.exchange(5.0) is ExchangeResult.TIMEOUT
            results = until_good(lambda: link.exchange(6.0))
            assert set(results) == {ExchangeResult.DISCONNECTED, ExchangeResult.OK}
            assert link.reading.force_N == 12.0


@pytest.mark.parametrize("write", [23, 16])
def test_replies_late_by_one_request_for_ever_are_never_believed(write):
    with ScriptedPty() as server:
        functions = registers(write, 23 if write == 23 else 3, without=("heartbeat",))
        with opened(server, rtu_config(server.port, registers=functions, timeout_s=0.02)) as (link, _):
            held = []

            def answer(frame, number):
                held.append(server.good(frame))
                return [held[-2]] if len(held) > 1 else []

            server.answer = answer
            results = set()
            for tick in range(40):
                results.add(link.exchange(float(tick)))
                time.sleep(0.005)
            assert ExchangeResult.OK not in results
            assert results & {ExchangeResult.ECHO_MISMATCH, ExchangeResult.WRONG_FUNCTION, ExchangeResult.WRONG_COUNT}


def test_the_echo_tells_a_reply_late_by_one_from_the_right_one(rtu):
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


GARBLED_VALUE = {"tcp": lambda reply: [reply[:10] + b"\1\1"], "rtu": patched(4, b"\7")}


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_the_single_register_write_wants_its_value_back(wire):
    server_class, make_config = (ScriptedTcp, tcp_config) if wire == "tcp" else (ScriptedPty, rtu_config)
    single = registers(6, 3, without=("command_sequence", "command_echo"))
    single["voltage_setpoint"] |= {"type": "int16", "scale": 0.01}
    with server_class() as server, opened(server, make_config(server.port, registers=single)) as (link, _):
        assert link.exchange(12.344) is ExchangeResult.OK
        assert link.exchange(7.5) is ExchangeResult.OK
        assert server.bench.get(100, ">h") == 750
        assert link.written_V == pytest.approx(7.5)
        server.once(lambda frame: GARBLED_VALUE[wire](server.good(frame)))
        assert link.exchange(3.0) is ExchangeResult.WRONG_COUNT


def test_local_echo_of_the_request_is_explained(rtu):
    link, server = rtu
    server.once(lambda frame: [bytes(frame), 0.001, server.good(frame)])
    assert link.exchange(3.0) is ExchangeResult.MALFORMED
    assert "local echo" in link.hint


def test_bad_checksums_in_a_row_hint_at_baudrate_and_parity(rtu):
    link, server = rtu
    server.answer = lambda frame, _number: flipped(server.good(frame))
    for _ in range(4):
        assert link.exchange(3.0) is ExchangeResult.BAD_CRC
    assert link.hint == ""
    link.exchange(3.0)
    assert "check baudrate and parity" in link.hint
    server.answer = lambda frame, _number: [server.good(frame)]
    until_good(lambda: link.exchange(3.0))
    assert link.hint == ""


def test_random_bytes_never_raise_and_are_never_believed(rtu):
    link, server = rtu
    source = random.Random(21)
    server.answer = lambda _frame, _number: [source.randbytes(source.randrange(1, 300))]
    before = snapshot(link.reading)
    link._timeout_s = 0.01
    for _ in range(60):
        assert link.exchange(1.0) is not ExchangeResult.OK
        link._wire._port._settled_at_s = 0.0
    assert snapshot(link.reading) == before


def test_a_port_held_by_another_process_names_it():
    holder = "import serial, sys; p = serial.Serial(sys.argv[1], exclusive=True); print(flush=True); sys.stdin.read()"
    with ScriptedPty() as server:
        arguments = [sys.executable, "-c", holder, server.port]
        with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            with pytest.raises(BusyError, match=rf"{server.port} is held by process \d+ \("):
                make_link(rtu_config(server.port)).open()
            process.stdin.close()


def test_a_port_that_does_not_exist_says_so():
    with pytest.raises(UnreachableError, match="does not exist: is the adapter plugged in"):
        make_link(rtu_config("/dev/serial/by-id/none")).open()


def test_a_vanished_port_is_no_spin_and_is_found_again_under_its_name(tmp_path):
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


def test_a_request_that_the_port_takes_in_parts_is_finished(rtu, monkeypatch):
    link, _ = rtu
    write = os.write
    ours = link._wire._port._descriptor
    monkeypatch.setattr(os, "write", lambda fd, data: write(fd, bytes(data[:3]) if fd == ours else data))
    assert link.exchange(3.0) is ExchangeResult.OK


def test_frames_keep_their_silence():
    with ScriptedPty() as server, opened(server, rtu_config(server.port, silent_interval="fixed")) as (link, _):
        begun_s = time.monotonic()
        for _ in range(11):
            assert link.exchange(1.0) is ExchangeResult.OK
        assert time.monotonic() - begun_s > 10 * 0.00175


def test_what_the_port_holds_from_before_is_no_reply():
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
