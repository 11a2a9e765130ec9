"""A link by ASCII lines: invalid and late lines, set-up, patterns and templates."""

import time
from pathlib import Path

import pytest

from piezod.config import load_bench
from piezod.config.link import SerialLineLink
from piezod.errors import CheckFailedError, ConfigurationError, IdentityError, UnreachableError
from piezod.transport import ExchangeResult, make_link, verify_identity
from tests.unit.transport.conftest import TIMEOUT_S, line_config, opened
from tests.unit.transport.scripted import ScriptedLine, snapshot, until_good


def answering(server, text):
    """Answer the next `GET` by `text` of the valid line."""
    first = server.bench.heartbeat

    def answer(frame, number):
        good = server.good(frame)
        return [text(good)] if frame == b"GET\n" and server.bench.heartbeat == first + 1 else [good]

    server.answer = answer


GARBLED = {
    "no end of line": (lambda good: good[:-1], ExchangeResult.TIMEOUT),
    "nothing": (lambda _good: b"", ExchangeResult.TIMEOUT),
    "an error message": (lambda _good: b"ERR 5\n", ExchangeResult.MALFORMED),
    "text before": (lambda good: b"x" + good, ExchangeResult.MALFORMED),
    "not ascii": (lambda _good: b"\xff\xfe\n", ExchangeResult.MALFORMED),
    "underscores": (lambda _good: b"F=4_1.5 V=1 N=5\n", ExchangeResult.MALFORMED),
    "no number": (lambda _good: b"F=abc V=1 N=5\n", ExchangeResult.MALFORMED),
    "not finite": (lambda _good: b"F=nan V=1 N=5\n", ExchangeResult.NOT_FINITE),
    "overflow": (lambda _good: b"F=1e999 V=1 N=5\n", ExchangeResult.NOT_FINITE),
    "heartbeat as before": (lambda _good: b"F=1 V=1 N=1\n", ExchangeResult.HEARTBEAT_STOOD),
    "a line without end": (lambda _good: b"y" * 3000, ExchangeResult.TIMEOUT),
}


@pytest.mark.parametrize("case", GARBLED)
def test_a_garbled_line_is_not_used_and_the_next_line_is_accepted(line, case):
    link, server = line
    change, expected = GARBLED[case]
    before = snapshot(link.reading)
    answering(server, change)
    assert link.exchange(7.0) is expected
    assert snapshot(link.reading) == before
    until_good(lambda: link.exchange(8.0))
    assert link.reading.force_N == 16.0


def test_a_late_line_is_never_used_for_the_next_request():
    config = {"measure": {"send": "GET", "reply": r"F=(?P<force_N>\S+).*"}}
    with ScriptedLine() as server, opened(server, line_config(server.port, **config)) as (link, _):
        asked = []

        def answer(frame, number):
            asked.append(frame)
            late = frame == b"GET\n" and asked.count(frame) == 1
            return [1.5 * TIMEOUT_S, server.good(frame)] if late else [server.good(frame)]

        server.answer = answer
        assert link.exchange(5.0) is ExchangeResult.TIMEOUT
        until_good(lambda: link.exchange(6.0))
        assert link.reading.force_N == 12.0


def test_the_written_voltage_equals_the_number_in_the_line(line):
    link, server = line
    assert link.exchange(1.0 / 3.0) is ExchangeResult.OK
    assert link.written_V == 0.333
    assert b"SET 0.333\n" in server.bench.requests


def test_a_poll_sends_only_the_line_of_measure(line):
    link, server = line
    sent = len(server.bench.requests)
    assert link.poll() is ExchangeResult.OK
    assert server.bench.requests[sent:] == [b"GET\n"]


def test_set_up_lines_are_sent_at_open_and_after_every_reopening(line):
    link, server = line
    assert server.bench.requests[0] == b"INIT\n"
    answering(server, lambda _good: b"")
    link.exchange(1.0)
    until_good(lambda: link.exchange(1.0))
    assert server.bench.requests.count(b"INIT\n") == 2


def test_a_set_up_line_without_its_acknowledgement_is_an_error_of_open():
    with ScriptedLine() as server:
        link = make_link(line_config(server.port, setup=[{"send": "INIT", "reply": "ready"}]))
        with pytest.raises(UnreachableError, match=r"link\.setup\[0\], 'INIT', ended in malformed: check its reply"):
            link.open()


@pytest.mark.parametrize(("answer", "opens"), [(b"0\n", True), (b"A=0\n", True), (b"1\n", False), (b"A=1\n", False)])
def test_a_servo_that_is_still_on_is_read_back_and_refused(answer, opens):
    profile = load_bench(Path(__file__).parents[3] / "config" / "pi_e625.yaml").link.setup
    with ScriptedLine() as server:
        asked = []

        def replies(frame, _number):
            asked.append(frame)
            return [answer] if frame.startswith(b"SVO?") else []

        server.answer = replies
        link = make_link(line_config(server.port, setup=[one.model_dump() for one in profile]))
        if opens:
            link.open()
            link.close()
        else:
            with pytest.raises(UnreachableError, match=r"link\.setup\[1\], 'SVO\? A', ended in malformed"):
                link.open()
        assert asked[:2] == [b"SVO A 0\n", b"SVO? A\n"]


def test_a_configured_acknowledgement_is_awaited():
    fields = {"set_voltage": {"send": "SET {voltage_V:.1f}", "reply": "ok"}}
    with ScriptedLine() as server, opened(server, line_config(server.port, **fields)) as (link, _):
        server.answer = lambda frame, _number: [server.good(frame) or b"ok\n"]
        assert link.exchange(2.0) is ExchangeResult.OK
        server.answer = lambda frame, _number: [server.good(frame)]
        assert link.exchange(2.0) is ExchangeResult.TIMEOUT


def test_another_identity_is_refused_with_the_reply():
    with ScriptedLine() as server:
        config = line_config(server.port, identity={"send": "ID", "reply": "E-625.*"})
        with opened(server, config) as (link, _), pytest.raises(IdentityError, match="answered b'bench 7', expected"):
            verify_identity(link)


def test_the_watchdog_time_is_the_acknowledged_time(line):
    link, server = line
    link.write_register("watchdog_ms", 150.0)
    assert server.bench.requests[-1] == b"DOG 150\n"
    assert link.read_register("watchdog_ms") == 150.0


def test_the_roles_are_the_groups_of_the_patterns(line):
    link, _ = line
    assert link.has("force")
    assert link.has("heartbeat")
    assert not link.has("temperature")
    assert link.read_register("force") == 2.0
    with pytest.raises(ConfigurationError, match="no configured line has the role 'temperature'"):
        link.read_register("temperature")


@pytest.mark.parametrize(
    "template",
    [
        "SVA",
        "SVA {",
        "SVA {0}",
        "SVA {voltage}",
        "SVA {voltage_V} {voltage_V}",
        "SVA {voltage_V!r}",
        "SVA {voltage_V.real}",
        "SVA {voltage_V:.3q}",
        "SVA {voltage_V:d}",
        "SVA {voltage_V:%}",
        "SVA {voltage_V:{voltage_V}}",
        "SV\u00c4 {voltage_V}",
    ],
)
def test_a_template_without_exactly_one_voltage_is_refused(template):
    with pytest.raises(ConfigurationError, match=r"link\.set_voltage\.send is"):
        make_link(line_config("/dev/none", set_voltage={"send": template}))


@pytest.mark.parametrize("pattern", ["(", "(?P<force>.*)", "(?P<power_W>.*)"])
def test_an_invalid_pattern_is_refused(pattern):
    with pytest.raises(ConfigurationError, match=r"link\.measure\.reply"):
        make_link(line_config("/dev/none", measure={"send": "GET", "reply": pattern}))


def test_braces_and_text_around_the_number_are_sent():
    fields = {"kind": "serial_line", "port": "/dev/none", "set_voltage": {"send": "{{X}} {voltage_V:+08.2f} V"}}
    link = make_link(SerialLineLink.model_validate(fields))
    assert link._set_voltage.fill(-3.14159) == (b"{X} -0003.14 V\n", -3.14)


def test_a_device_that_sends_only_its_prompt_costs_one_timeout(line):
    link, server = line
    server.answer = lambda _frame, _number: [b"*"]
    begun_s = time.monotonic()
    assert link.exchange(1.0) is ExchangeResult.TIMEOUT
    assert time.monotonic() - begun_s < 10 * TIMEOUT_S


@pytest.mark.parametrize("answer", [b"DOG ten\n", b"DOG 1_00\n"])
def test_a_watchdog_time_that_is_not_a_number_is_refused(answer):
    watchdog = {"send": "DOG {watchdog_ms:.0f}", "reply": r"DOG (?P<watchdog_ms>\S+)"}
    with ScriptedLine() as server, opened(server, line_config(server.port, watchdog=watchdog)) as (link, _):
        server.answer = lambda frame, _number: [answer if frame.startswith(b"DOG") else server.good(frame)]
        with pytest.raises(CheckFailedError, match=r"link\.watchdog answered"):
            link.write_register("watchdog_ms", 100.0)
