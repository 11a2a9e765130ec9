"""The metrics: what they say, and to whom."""

import asyncio

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from piezod.control import ROW_DTYPE, Cause, State
from piezod.daemon.metrics import BenchMetrics, MetricsServer
from piezod.daemon.statistics import Tally
from piezod.errors import BusyError
from piezod.transport import ExchangeResult


def rows(count, **fields):
    made = np.zeros(count, ROW_DTYPE)
    made["tick"] = np.arange(count)
    for name, value in fields.items():
        made[name] = value
    return made


def make_tally():
    tally = Tally(lambda *_: None)
    first = rows(1000, state=State.RUNNING, force_N=12.5, readback_V=np.nan, lateness_ns=25_000, exchange_ns=150_000)
    first["result"][:10] = ExchangeResult.TIMEOUT
    first["tick"][500:] += 7
    tally.add(first)
    tally.add(rows(1, tick=1007, state=State.FAULT, cause=Cause.OVER_FORCE, force_N=400.0, readback_V=np.nan))
    return tally


async def fetch(request=b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n", bench_name="emulator"):
    log = []
    server = MetricsServer(BenchMetrics(bench_name, make_tally()), log.append)
    await server.open(0)
    port = int(log[0].rpartition(":")[2].partition("/")[0])
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    answer = await reader.read()
    writer.close()
    await server.close()
    head, _, body = answer.partition(b"\r\n\r\n")
    return head.decode(), body.decode()


def sample(body, name, **labels):
    """The one sample of that name and those labels."""
    found = [
        one.value
        for family in text_string_to_metric_families(body)
        for one in family.samples
        if one.name == name and labels.items() <= one.labels.items()
    ]
    assert len(found) == 1, (name, found)
    return found[0]


def test_every_count_is_that_of_the_rows():
    head, body = asyncio.run(fetch())
    assert head.startswith("HTTP/1.1 200 OK")
    assert sample(body, "piezod_ticks_total", bench="emulator") == 1001
    assert sample(body, "piezod_missed_ticks_total") == 7
    assert sample(body, "piezod_exchanges_total", result="timeout") == 10
    assert sample(body, "piezod_exchanges_total", result="ok") == 991
    assert sample(body, "piezod_faults_total", cause="over_force") == 1
    assert sample(body, "piezod_state", state="fault") == 1
    assert sample(body, "piezod_state", state="running") == 0
    assert sample(body, "piezod_force_newtons") == 400.0


def test_a_histogram_counts_up_to_each_bound():
    _, body = asyncio.run(fetch())
    assert sample(body, "piezod_tick_lateness_seconds_bucket", le="2e-05") == 1
    assert sample(body, "piezod_tick_lateness_seconds_bucket", le="5e-05") == 1001
    assert sample(body, "piezod_tick_lateness_seconds_bucket", le="+Inf") == 1001
    assert sample(body, "piezod_tick_duration_seconds_sum") == pytest.approx(0.15)


def test_a_value_that_the_device_does_not_have_is_not_shown():
    _, body = asyncio.run(fetch())
    assert "piezod_voltage_readback_volts{" not in body


@pytest.mark.parametrize(
    "request_line", [b"POST /metrics HTTP/1.1\r\n\r\n", b"GET /arm HTTP/1.1\r\n\r\n", b"x\r\n\r\n"]
)
def test_nothing_else_is_answered(request_line):
    head, _ = asyncio.run(fetch(request_line))
    assert head.startswith("HTTP/1.1 404")


def test_a_request_too_long_is_hung_up_on():
    assert asyncio.run(fetch(b"GET /metrics HTTP/1.1\r\nX: " + b"y" * 20_000 + b"\r\n\r\n"))[0] == ""


def test_it_listens_on_the_loopback_alone_and_says_when_the_port_is_taken():
    async def twice():
        log = []
        first = MetricsServer(BenchMetrics("a", make_tally()), log.append)
        await first.open(0)
        address = first._server.sockets[0].getsockname()
        assert address[0] == "127.0.0.1"
        second = MetricsServer(BenchMetrics("a", make_tally()), log.append)
        try:
            await second.open(address[1])
        finally:
            await first.close()

    with pytest.raises(BusyError, match="cannot be bound"):
        asyncio.run(twice())


def test_transitions_are_told_once_each_across_looks():
    told = []
    tally = Tally(lambda state, cause, row: told.append((state, cause)))
    for state, cause in ((State.DISARMED, Cause.NONE), (State.ARMING, Cause.ARMED), (State.ARMING, Cause.ARMED)):
        tally.add(rows(5, state=state, cause=cause))
    assert told == [(State.ARMING, Cause.ARMED)]
