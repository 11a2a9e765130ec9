import contextlib
import random
import signal
import socket
import struct
import threading
import time

import pytest

from piezod.errors import BusyError, ConfigurationError, IdentityError, TemporaryError, UnreachableError
from piezod.transport import ExchangeResult, make_link, modbus_tcp, verify_identity
from tests.unit.transport.conftest import TIMEOUT_S, opened, tcp_config
from tests.unit.transport.scripted import CLOSE, RESET, ScriptedTcp, descriptors, registers, snapshot, until_good

DATA = 9  # the registers begin there: MBAP, function, byte count


def patched(at, value):
    def change(reply):
        changed = bytearray(reply)
        changed[at : at + len(value)] = value
        return [bytes(changed)]

    return change


def resized(registers_more):
    """A consistent reply with more or fewer registers."""

    def change(reply):
        data = reply[DATA:] + b"\0\0" * registers_more if registers_more > 0 else reply[DATA : 2 * registers_more]
        return [reply[:4] + struct.pack(">HBBB", 3 + len(data), reply[6], reply[7], len(data)) + data]

    return change


def refused(code):
    return lambda reply: [reply[:4] + struct.pack(">HBBB", 3, reply[6], reply[7] | 0x80, code)]


GARBLED = {
    "transaction of another request": (patched(0, b"\x70\x00"), ExchangeResult.WRONG_TRANSACTION),
    "transaction zero": (patched(0, b"\0\0"), ExchangeResult.WRONG_TRANSACTION),
    "protocol one": (patched(2, b"\0\1"), ExchangeResult.MALFORMED),
    "length zero": (patched(4, b"\0\0"), ExchangeResult.MALFORMED),
    "length one": (patched(4, b"\0\1"), ExchangeResult.MALFORMED),
    "length 65535": (patched(4, b"\xff\xff"), ExchangeResult.MALFORMED),
    "another unit": (patched(6, b"\2"), ExchangeResult.WRONG_UNIT),
    "another function": (patched(7, b"\3"), ExchangeResult.WRONG_FUNCTION),
    "byte count above the payload": (patched(8, b"\x10"), ExchangeResult.WRONG_COUNT),
    "odd byte count": (patched(8, b"\x0d"), ExchangeResult.WRONG_COUNT),
    "one register more": (resized(1), ExchangeResult.WRONG_COUNT),
    "one register fewer": (resized(-1), ExchangeResult.WRONG_COUNT),
    "exception 2": (refused(2), ExchangeResult.DEVICE_EXCEPTION),
    "exception 4": (refused(4), ExchangeResult.DEVICE_EXCEPTION),
    "force not a number": (patched(DATA, struct.pack(">f", float("nan"))), ExchangeResult.NOT_FINITE),
    "force infinite": (patched(DATA, struct.pack(">f", float("-inf"))), ExchangeResult.NOT_FINITE),
    "force above high": (patched(DATA, struct.pack(">f", 1000.5)), ExchangeResult.OUT_OF_RANGE),
    "heartbeat as before": (patched(DATA + 8, struct.pack(">H", 1)), ExchangeResult.HEARTBEAT_STOOD),
    "heartbeat back": (patched(DATA + 8, struct.pack(">H", 0)), ExchangeResult.HEARTBEAT_STOOD),
    "echo of the command before": (patched(DATA + 10, struct.pack(">H", 1)), ExchangeResult.ECHO_MISMATCH),
    "half a reply": (lambda reply: [reply[:11]], ExchangeResult.TIMEOUT),
    "nothing": (lambda _reply: [], ExchangeResult.TIMEOUT),
    "half a reply, then closed": (lambda reply: [reply[:11], CLOSE], ExchangeResult.DISCONNECTED),
    "closed": (lambda _reply: [CLOSE], ExchangeResult.DISCONNECTED),
    "reset": (lambda _reply: [RESET], ExchangeResult.DISCONNECTED),
}


@pytest.mark.parametrize("case", GARBLED)
def test_of_a_garbled_reply_nothing_is_used_and_the_next_is_good(tcp, case):
    link, server = tcp
    change, expected = GARBLED[case]
    before = snapshot(link.reading)
    server.once(lambda frame: change(server.good(frame)))
    assert link.exchange(7.0) is expected
    assert snapshot(link.reading) == before
    assert link.counts[expected] == 1
    until_good(lambda: link.exchange(8.0))
    assert link.reading.force_N == 16.0


def test_the_code_of_an_exception_is_kept(tcp):
    link, server = tcp
    server.once(lambda frame: refused(6)(server.good(frame)))
    link.exchange(1.0)
    assert link.last_exception == 6


def test_a_reply_in_segments_of_one_byte_is_accepted(tcp):
    link, server = tcp
    server.once(lambda frame: [part for byte in server.good(frame) for part in (bytes((byte,)), 0.0005)])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.reading.force_N == 6.0


def test_of_two_replies_in_one_segment_the_second_is_discarded_and_counted(tcp):
    link, server = tcp
    server.once(lambda frame: [(reply := server.good(frame)) + reply])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.stale_bytes == 23
    assert link.exchange(4.0) is ExchangeResult.OK
    assert link.reading.force_N == 8.0


def test_an_older_reply_before_the_good_one_is_discarded(tcp):
    link, server = tcp
    server.once(lambda frame: [patched(0, b"\0\1")(reply := server.good(frame))[0] + reply])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.reading.force_N == 6.0
    assert link.stale_bytes == 23


def test_bytes_that_come_unasked_between_requests_are_drained(tcp):
    link, server = tcp
    server.once(lambda frame: [server.good(frame), 0.005, b"noise"])
    assert link.exchange(3.0) is ExchangeResult.OK
    time.sleep(0.03)
    assert link.exchange(4.0) is ExchangeResult.OK
    assert link.stale_bytes == 5


def test_a_reply_after_the_timeout_is_never_used():
    with ScriptedTcp() as server:
        config = tcp_config(server.port, registers=registers(without=("heartbeat", "command_echo", "command_sequence")))
        with opened(server, config) as (link, _):
            server.once(lambda frame: [1.3 * TIMEOUT_S, server.good(frame)])
            assert link.exchange(5.0) is ExchangeResult.TIMEOUT
            until_good(lambda: link.exchange(6.0))
            assert link.reading.force_N == 12.0
            assert server.connections == 2


def test_replies_late_by_one_request_for_ever_are_never_believed(tcp):
    link, server = tcp
    held = []

    def answer(frame, number):
        held.append(server.good(frame))
        return [held[-2]] if len(held) > 1 else []

    server.answer = answer
    results = []
    for volt in range(5):
        results.append(link.exchange(float(volt)))
        time.sleep(0.06)
    assert ExchangeResult.OK not in results


def test_an_idle_connection_that_the_device_closed_is_made_anew(tcp):
    link, server = tcp
    server.once(lambda frame: [server.good(frame), CLOSE])
    assert link.exchange(2.0) is ExchangeResult.OK
    time.sleep(0.06)
    assert until_good(lambda: link.exchange(3.0)) == [ExchangeResult.DISCONNECTED, ExchangeResult.OK]


def test_a_device_that_is_gone_is_asked_for_at_most_every_50_ms(tcp, monkeypatch):
    link, server = tcp
    attempts = []
    server.answer = lambda _frame, _number: [CLOSE]
    connect = modbus_tcp.TcpWire._connect
    monkeypatch.setattr(modbus_tcp.TcpWire, "_connect", lambda self, deadline: attempts.append(connect(self, deadline)))
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        assert link.exchange(1.0) is ExchangeResult.DISCONNECTED
        time.sleep(0.001)
    assert 2 <= len(attempts) <= 7


def test_descriptors_stay_the_same_over_200_reconnects(tcp, monkeypatch):
    link, server = tcp
    monkeypatch.setattr(modbus_tcp, "RECONNECT_S", 0.0)
    server.answer = lambda frame, _number: [server.good(frame), CLOSE]
    until_good(lambda: link.exchange(1.0))
    before, first = descriptors(), server.connections
    while server.connections < first + 200:
        until_good(lambda: link.exchange(1.0))
    link.close()
    time.sleep(0.05)
    assert descriptors() <= before


def test_a_signal_does_not_cut_an_exchange_short(tcp):
    link, server = tcp
    server.once(lambda frame: [0.03, server.good(frame)])
    previous = signal.signal(signal.SIGALRM, lambda *_: None)
    signal.setitimer(signal.ITIMER_REAL, 0.001, 0.001)
    try:
        assert link.exchange(3.0) is ExchangeResult.OK
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


class Reluctant:
    """A socket that takes three bytes at a time."""

    def __init__(self, connection):
        self.connection = connection

    def send(self, data):
        return self.connection.send(bytes(data[:3]))

    def __getattr__(self, name):
        return getattr(self.connection, name)


def test_a_request_that_the_kernel_takes_in_parts_is_finished(tcp):
    link, _ = tcp
    link._wire._socket = Reluctant(link._wire._socket)
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.reading.force_N == 6.0


class Busy:
    """A socket that can neither send nor receive at the first attempt."""

    def __init__(self, connection):
        self.connection, self.refusals = connection, {"send", "recv_into"}

    def refuse_once(self, name):
        if name in self.refusals:
            self.refusals.remove(name)
            raise BlockingIOError

    def send(self, data):
        self.refuse_once("send")
        return self.connection.send(data)

    def recv_into(self, space):
        self.refuse_once("recv_into")
        return self.connection.recv_into(space)

    def __getattr__(self, name):
        return getattr(self.connection, name)


def test_what_would_block_is_tried_again(tcp):
    link, _ = tcp
    link._wire._socket = busy = Busy(link._wire._socket)
    generation = link._wire.generation
    assert link.exchange(3.0) is ExchangeResult.OK
    assert not busy.refusals
    assert link._wire.generation == generation


@pytest.mark.parametrize("voltage_V", [float("nan"), float("inf"), 1e39])
def test_a_voltage_that_cannot_be_encoded_is_not_sent(tcp, voltage_V):
    link, server = tcp
    sent = len(server.bench.requests)
    assert link.exchange(voltage_V) is ExchangeResult.OUT_OF_RANGE
    assert len(server.bench.requests) == sent
    assert link.written_V == 1.0
    assert link.exchange(2.0) is ExchangeResult.OK


def test_written_voltage_is_what_the_device_holds(tcp):
    link, server = tcp
    assert link.exchange(1.0 / 3.0) is ExchangeResult.OK
    assert link.written_V == server.bench.voltage_V != 1.0 / 3.0


def test_a_poll_after_commands_wants_the_last_ones_echo(tcp):
    link, server = tcp
    assert link.poll() is ExchangeResult.OK
    server.bench.put(102, ">H", 999)
    assert link.poll() is ExchangeResult.ECHO_MISMATCH


def test_a_device_that_restarted_is_refused_while_driving_and_accepted_while_watching(tcp):
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


def test_random_bytes_never_raise_and_are_never_believed(tcp):
    link, server = tcp
    source = random.Random(20)
    server.answer = lambda _frame, _number: [source.randbytes(source.randrange(1, 300))]
    before = snapshot(link.reading)
    link._timeout_s = 0.01
    for _ in range(60):
        assert link.exchange(1.0) is not ExchangeResult.OK
        link._wire._not_before_s = 0.0
    assert snapshot(link.reading) == before


def test_a_refused_connection_says_so():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(UnreachableError, match=f"127.0.0.1:{port} refused the connection: is the device on"):
        make_link(tcp_config(port)).open()


def test_a_host_that_does_not_answer_is_given_up_after_the_connect_timeout():
    with socket.socket() as silent, contextlib.ExitStack() as stack:
        silent.bind(("127.0.0.1", 0))
        silent.listen(0)
        for _ in range(2):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(silent.getsockname())
        link = make_link(tcp_config(silent.getsockname()[1], connect_timeout_s=0.1))
        with pytest.raises(UnreachableError, match=r"did not answer within 0\.1 s"):
            link.open()


def test_every_address_of_a_name_is_tried(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        refusing = taken.getsockname()
    with ScriptedTcp() as server:
        found = [
            (socket.AF_INET, socket.SOCK_STREAM, 6, "", address) for address in (refusing, ("127.0.0.1", server.port))
        ]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
        with opened(server, tcp_config(server.port, host="bench.local")) as (link, _):
            assert link.exchange(1.0) is ExchangeResult.OK


def test_an_unknown_host_says_so(monkeypatch):
    def fail(*_, **__):
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", fail)
    with pytest.raises(UnreachableError, match="cannot be resolved"):
        make_link(tcp_config(502)).open()


@pytest.mark.parametrize("linger", [False, True])
def test_a_device_that_closes_a_second_connection_at_once_is_called_busy(linger):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def turn_away():
            connection, _ = server.accept()
            if linger:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            connection.close()

        thread = threading.Thread(target=turn_away)
        thread.start()
        with pytest.raises(BusyError, match="another client may hold the device"):
            make_link(tcp_config(server.getsockname()[1])).open()
        thread.join()


def test_a_closed_link_stays_closed(tcp):
    link, _ = tcp
    link.close()
    link.close()
    assert link.exchange(1.0) is ExchangeResult.DISCONNECTED
    assert link.poll() is ExchangeResult.DISCONNECTED


def test_registers_of_set_up_are_read_and_written(tcp):
    link, server = tcp
    link.write_register("watchdog_ms", 150.0)
    assert server.bench.get(110, ">H") == 150
    assert link.read_register("watchdog_ms") == 150.0
    assert link.has("watchdog_ms")
    assert not link.has("virtual_time")


def test_a_register_that_is_missing_or_too_small_is_named(tcp):
    link, _ = tcp
    with pytest.raises(ConfigurationError, match=r"registers\.virtual_time is missing"):
        link.read_register("virtual_time")
    with pytest.raises(ConfigurationError, match=r"registers\.watchdog_ms: 70000 cannot be encoded"):
        link.write_register("watchdog_ms", 70000.0)


@pytest.mark.parametrize(("code", "error"), [(1, ConfigurationError), (2, ConfigurationError), (6, TemporaryError)])
def test_an_exception_at_set_up_names_register_and_address(tcp, code, error):
    link, server = tcp
    server.once(lambda frame: refused(code)(server.good(frame)))
    with pytest.raises(error, match=rf"registers\.watchdog_ms at address 110: exception {code}"):
        link.read_register("watchdog_ms")


def test_identity_is_verified(tcp):
    verify_identity(tcp[0])


def test_another_device_is_named_with_both_values(tcp):
    link, server = tcp
    server.bench.put(0, ">H", 7)
    with pytest.raises(IdentityError, match=r"registers\.identity at address 0 is 7, expected 20570"):
        verify_identity(link)


def test_another_word_order_is_named(tcp):
    link, server = tcp
    big = struct.pack(">f", 1234.5)
    server.bench.memory[4:8] = big[2:] + big[:2]
    with pytest.raises(IdentityError, match="sends it in order CDAB, configured is ABCD; set order: CDAB"):
        verify_identity(link)


def test_a_name_that_stands_for_a_routable_address_is_not_spoken_to_in_plain(monkeypatch):
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("8.8.8.8", 502))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    link = make_link(tcp_config(502, host="bench.example.org"))
    with pytest.raises(ConfigurationError, match=r"routable address 8\.8\.8\.8"):
        link.open()
