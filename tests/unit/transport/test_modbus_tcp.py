"""A TCP wire: fragments, unrequested bytes, reconnection, and the errors of a connection."""

import contextlib
import signal
import socket
import struct
import threading
import time

import pytest

from piezod.errors import BusyError, ConfigurationError, UnreachableError
from piezod.runtime import clock, sockets
from piezod.transport import ExchangeResult, make_link, modbus, modbus_tcp
from tests.unit.transport.conftest import opened, tcp_config
from tests.unit.transport.garbled import raw
from tests.unit.transport.scripted import CLOSE, ScriptedTcp, descriptors, until_good


def test_of_two_replies_in_one_segment_the_second_is_discarded_and_counted(tcp):
    link, server = tcp
    server.once(lambda frame: [(reply := server.good(frame)) + reply])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.stale_bytes == 23
    assert link.exchange(4.0) is ExchangeResult.OK
    assert link.reading.force_N == 8.0


def test_an_older_reply_before_the_good_one_is_discarded(tcp):
    link, server = tcp
    server.once(lambda frame: [raw(0, b"\0\1")(reply := server.good(frame))[0] + reply])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.reading.force_N == 6.0
    assert link.stale_bytes == 23


def test_unrequested_bytes_between_requests_are_discarded(tcp):
    link, server = tcp
    server.once(lambda frame: [server.good(frame), 0.005, b"noise"])
    assert link.exchange(3.0) is ExchangeResult.OK
    time.sleep(0.03)
    assert link.exchange(4.0) is ExchangeResult.OK
    assert link.stale_bytes == 5


def test_an_idle_connection_that_the_device_closed_is_reopened(tcp):
    link, server = tcp
    server.once(lambda frame: [server.good(frame), CLOSE])
    assert link.exchange(2.0) is ExchangeResult.OK
    time.sleep(0.06)
    assert until_good(lambda: link.exchange(3.0)) == [ExchangeResult.DISCONNECTED, ExchangeResult.OK]


def test_a_loss_between_two_exchanges_is_reported_before_a_voltage_is_sent(tcp):
    """The device may have restarted, at rest: a voltage sent at once would be a step of its output."""
    link, server = tcp
    assert link.exchange(2.0) is ExchangeResult.OK
    server.once(lambda _: [CLOSE])
    assert link.compare_command() is ExchangeResult.DISCONNECTED
    time.sleep(0.06)
    assert link.exchange(50.0) is ExchangeResult.DISCONNECTED
    assert link.written_V == 2.0
    assert until_good(lambda: link.exchange(51.0))[-1] is ExchangeResult.OK
    assert link.written_V == 51.0


def test_reconnection_is_attempted_at_most_every_50_ms(tcp, monkeypatch):
    link, server = tcp
    attempts = []
    server.answer = lambda _frame, _number: [CLOSE]
    connect = modbus_tcp.connect
    monkeypatch.setattr(modbus_tcp, "connect", lambda *how: attempts.append(how) or connect(*how))
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        assert link.exchange(1.0) is ExchangeResult.DISCONNECTED
        time.sleep(0.001)
    assert 2 <= len(attempts) <= 7


def test_a_request_whose_deadline_has_come_is_not_sent(tcp, monkeypatch):
    """The process was suspended: the device may have taken over since."""
    link, server = tcp
    before = server.number
    monkeypatch.setattr(clock, "monotonic", lambda: 5.0)
    assert link._wire.transact(link._read, 5.0) is not ExchangeResult.OK
    time.sleep(0.05)
    assert server.number == before


def test_setting_up_waits_between_two_attempts_to_connect(tcp, monkeypatch):
    link, _ = tcp
    now_s, pauses = [100.0], []
    monkeypatch.setattr(clock, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(clock, "sleep", pauses.append)

    class Refusing:
        framing, exception_code, hint, answered, description = "tcp", 0, "", True, "nobody"

        def ensure_open(self, _deadline_s):
            now_s[0] += 0.1
            return ExchangeResult.DISCONNECTED

    monkeypatch.setattr(link, "_wire", Refusing())
    with pytest.raises(UnreachableError):
        link.read_register("watchdog_ms")
    assert len(pauses) > 1
    assert set(pauses) == {modbus.SET_UP_RETRY_S}


def test_descriptors_stay_the_same_over_200_reconnects(tcp, monkeypatch):
    link, server = tcp
    monkeypatch.setattr(modbus_tcp, "RECONNECT_S", 0.0)
    server.answer = lambda frame, _number: [server.good(frame), *([CLOSE] if frame[7] == 23 else [])]
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


class Slow:
    """A socket that accepts three bytes at a time."""

    def __init__(self, connection):
        self.connection = connection

    def send(self, data):
        return self.connection.send(bytes(data[:3]))

    def __getattr__(self, name):
        return getattr(self.connection, name)


def test_a_request_that_the_kernel_accepts_in_parts_is_completed(tcp):
    link, _ = tcp
    link._wire._socket = Slow(link._wire._socket)
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.reading.force_N == 6.0


class Busy:
    """A socket that would block at the first attempt to send and to receive."""

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


def test_a_call_that_would_block_is_repeated(tcp):
    link, _ = tcp
    link._wire._socket = busy = Busy(link._wire._socket)
    generation = link._wire.generation
    assert link.exchange(3.0) is ExchangeResult.OK
    assert not busy.refusals
    assert link._wire.generation == generation


def test_the_error_of_a_refused_connection_names_the_port():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(UnreachableError, match=f"127.0.0.1:{port} refused the connection: is the device on"):
        make_link(tcp_config(port)).open()


def test_a_host_that_does_not_answer_is_an_error_after_the_connect_timeout():
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
        monkeypatch.setattr(sockets, "getaddrinfo", lambda *_, **__: found)
        with opened(server, tcp_config(server.port, host="bench.local")) as (link, _):
            assert link.exchange(1.0) is ExchangeResult.OK


def test_the_error_of_an_unknown_host_names_the_resolution(monkeypatch):
    def fail(*_, **__):
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(sockets, "getaddrinfo", fail)
    with pytest.raises(UnreachableError, match="cannot be resolved"):
        make_link(tcp_config(502)).open()


@pytest.mark.parametrize("linger", [False, True])
def test_a_device_that_closes_a_second_connection_at_once_is_busy(linger):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def close_at_once():
            connection, _ = server.accept()
            if linger:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            connection.close()

        thread = threading.Thread(target=close_at_once)
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


def test_a_second_open_ends_the_first_connection_before_it_connects():
    """A device for one client refuses the second connection while the first one is there."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = make_link(tcp_config(server.getsockname()[1]))
        link.open()
        connection, _ = server.accept()
    connection.settimeout(2.0)
    with connection:
        with pytest.raises(UnreachableError, match="refused the connection"):
            link.open()
        assert connection.recv(1) == b""  # not a time-out: the first one has ended
        assert link.exchange(1.0) is ExchangeResult.DISCONNECTED


def test_plain_modbus_to_a_name_with_a_routable_address_is_refused(monkeypatch):
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("8.8.8.8", 502))]
    monkeypatch.setattr(sockets, "getaddrinfo", lambda *_, **__: found)
    link = make_link(tcp_config(502, host="bench.example.org"))
    with pytest.raises(ConfigurationError, match=r"routable address 8\.8\.8\.8"):
        link.open()
