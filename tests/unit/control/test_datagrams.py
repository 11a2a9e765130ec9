"""Datagrams of a stream: age, order, sessions, range, and the shared key."""

import hmac
import os
import socket
import struct
import time

import pytest

from piezod.config.reference import StreamReference
from piezod.config.reference_range import ReferenceRange
from piezod.control.references import DatagramStream, Freshness, ValueResult
from piezod.control.references.datagram import DatagramGate, read_key
from piezod.errors import ConfigurationError

MS = 1_000_000
KEY = bytes(range(32))
RANGE = ReferenceRange(0.0, 300.0)
ACCEPTED, OUT_OF_ORDER, JUMPED = ValueResult.ACCEPTED, ValueResult.OUT_OF_ORDER, ValueResult.JUMPED


def plain(sequence, value=100.0, stamp_ns=0):
    return memoryview(struct.pack("<QQd", sequence, stamp_ns, value))


def in_session(session, sequence, value=100.0):
    return memoryview(struct.pack("<QQQd", session, sequence, 0, value))


def signed(session, sequence, value=100.0, key=KEY, stamp_ns=0):
    body = struct.pack("<QQQd", session, sequence, stamp_ns, value)
    return memoryview(body + hmac.new(key, body, "sha256").digest()[:16])


@pytest.fixture
def stream(tmp_path):
    config = StreamReference(kind="stream", listen=str(tmp_path / "s"), stale_after_s=0.1)
    reference = DatagramStream(config, RANGE)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.connect(config.listen)
        yield reference, sender
    reference.close()


def test_values_that_arrived_at_rest_are_stale_after_arming(stream):
    reference, sender = stream
    for sequence in range(8):
        sender.send(plain(sequence))
    reference.idle(0)
    reference.begin()
    reference.read(0, 60_000 * MS)
    assert reference.freshness is Freshness.STALE


def test_values_that_wait_in_the_socket_at_arming_are_discarded(stream):
    reference, sender = stream
    for sequence in range(8):
        sender.send(plain(sequence))
    reference.begin()
    reference.read(0, 60_000 * MS)
    assert reference.freshness is Freshness.STALE
    assert sum(reference.counts) == 0


def test_a_sender_that_goes_on_through_arming_is_live_at_once(stream):
    reference, sender = stream
    sender.send(plain(1, 150.0))
    reference.idle(1000 * MS)
    reference.begin()
    assert reference.read(0, 1050 * MS) == 150.0
    assert reference.freshness is Freshness.LIVE


def test_a_sender_that_begins_again_at_one_is_heard_after_arming_and_not_before():
    gate = DatagramGate(RANGE)
    assert gate.check(plain(500_000), 0) is ACCEPTED
    assert gate.check(plain(1), 5 * MS) is OUT_OF_ORDER
    gate.begin()
    assert gate.check(plain(1), 10 * MS) is ACCEPTED


def test_arming_lets_the_sender_of_a_socket_begin_again(stream):
    reference, sender = stream
    sender.send(plain(500_000, 100.0))
    reference.idle(0)
    reference.begin()
    sender.send(plain(1, 120.0))
    assert reference.read(0, MS) == 120.0


def test_a_wild_number_is_refused_and_does_not_block_the_next_one():
    gate = DatagramGate(RANGE)
    assert gate.check(plain(2**64 - 1), 0) is JUMPED
    assert gate.check(plain(7), MS) is ACCEPTED
    assert gate.check(plain(2**64 - 1), 2 * MS) is JUMPED
    assert gate.check(plain(2**62), 3 * MS) is JUMPED
    assert gate.check(plain(8), 4 * MS) is ACCEPTED


def test_a_sender_may_pause_and_may_count_nanoseconds():
    gate = DatagramGate(RANGE)
    assert gate.check(plain(1000), 0) is ACCEPTED
    assert gate.check(plain(1_001_000), 3600 * 1000 * MS) is ACCEPTED
    assert gate.check(plain(1_001_000 + 5 * MS), 3600 * 1000 * MS + 5 * MS) is ACCEPTED


def test_a_higher_session_begins_anew_and_a_lower_one_is_refused():
    gate = DatagramGate(RANGE)
    assert gate.check(in_session(5, 900), 0) is ACCEPTED
    assert gate.check(in_session(6, 1), 1) is ACCEPTED
    assert gate.check(in_session(5, 901), 2) is OUT_OF_ORDER
    assert gate.check(plain(902), 3) is OUT_OF_ORDER
    assert gate.check(in_session(2**64 - 1, 1), 4) is JUMPED
    assert gate.check(in_session(6, 2), 5) is ACCEPTED


@pytest.mark.parametrize("value", [300.1, -0.1, 1e300, -1e300])
def test_a_value_beyond_the_range_is_refused_and_not_clamped(value):
    gate = DatagramGate(RANGE)
    assert gate.check(plain(1, 100.0), 0) is ACCEPTED
    assert gate.check(plain(2, value), 1) is ValueResult.OUT_OF_RANGE
    assert gate.value_N == 100.0
    assert gate.check(plain(2, 300.0), 2) is ACCEPTED


def test_with_a_key_only_a_valid_tag_is_accepted():
    gate = DatagramGate(RANGE, KEY)
    good = bytes(signed(1, 1))
    assert gate.check(memoryview(good), 0) is ACCEPTED
    refused = [bytes(plain(2)), bytes(in_session(1, 2)), bytes(signed(1, 2, key=bytes(32))), b"", good + b"x"]
    refused += [good[:k] + bytes([good[k] ^ 1]) + good[k + 1 :] for k in range(len(good))]
    assert {gate.check(memoryview(one), 1) for one in refused} == {ValueResult.UNAUTHENTICATED}


def test_with_a_key_no_recorded_datagram_is_accepted_again_also_after_arming():
    gate = DatagramGate(RANGE, KEY)
    recorded = [signed(1, 1), signed(1, 2), signed(2, 1)]
    assert [gate.check(one, 0) for one in recorded] == [ACCEPTED] * 3
    gate.begin()
    assert [gate.check(one, 1) for one in recorded] == [OUT_OF_ORDER] * 3
    assert gate.check(signed(2, 2), 2) is ACCEPTED


def test_the_time_of_the_sender_counts_where_it_is_configured():
    gate = DatagramGate(RANGE, KEY, stamp_within_s=1.0)
    now_ns = time.time_ns()
    assert gate.check(signed(1, 1, stamp_ns=now_ns - 10**10), 0) is ValueResult.MISTIMED
    assert gate.check(signed(1, 1, stamp_ns=now_ns), 0) is ACCEPTED


def test_a_key_is_read_from_a_file_that_only_owner_and_group_can_read(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o640)
    assert read_key(str(path)) == KEY
    for mode in (0o644, 0o660, 0o641):
        path.chmod(mode)
        with pytest.raises(ConfigurationError, match="must be 0640 or less"):
            read_key(str(path))
    path.chmod(0o600)
    for content in ("", "abcd", "x" * 64):
        path.write_text(content)
        with pytest.raises(ConfigurationError, match="at least 32 hexadecimal digits"):
            read_key(str(path))
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_key(str(tmp_path / "none"))


def test_a_unix_stream_has_its_mode_whatever_the_umask_is(tmp_path):
    before = os.umask(0o027)
    try:
        reference = DatagramStream(StreamReference(kind="stream", listen=str(tmp_path / "s")), RANGE)
    finally:
        os.umask(before)
    found = (tmp_path / "s").stat()
    reference.close()
    assert (found.st_mode & 0o777, found.st_gid) == (0o660, os.getegid())
    assert not (tmp_path / "s").exists()
