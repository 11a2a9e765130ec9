"""Metrics: values, and limits of the server."""

import asyncio
import time

import numpy as np
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from piezod.control import ROW_DTYPE, Cause, State
from piezod.daemon.metrics import BenchMetrics, MetricsServer
from piezod.daemon.statistics import TickStatistics
from piezod.errors import BusyError
from piezod.transport import ExchangeResult


def rows(count, **fields):
    made = np.zeros(count, ROW_DTYPE)
    made["tick"] = np.arange(count)
    for name, value in fields.items():
        made[name] = value
    return made


def make_statistics():
    statistics = TickStatistics(lambda *_: None)
    first = rows(1000, state=State.RUNNING, force_N=12.5, readback_V=np.nan, lateness_ns=25_000, exchange_ns=150_000)
    first["result"][:10] = ExchangeResult.TIMEOUT
    first["tick"][500:] += 7
    statistics.add(first)
    statistics.add(rows(1, tick=1007, state=State.FAULT, cause=Cause.OVER_FORCE, force_N=400.0, readback_V=np.nan))
    return statistics


async def fetch(request=b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n", bench_name="emulator"):
    log = []
    server = MetricsServer(BenchMetrics(bench_name, make_statistics()), log.append)
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
    """Value of the only sample with this name and these labels."""
    found = [
        one.value
        for family in text_string_to_metric_families(body)
        for one in family.samples
        if one.name == name and labels.items() <= one.labels.items()
    ]
    assert len(found) == 1, (name, found)
    return found[0]


def test_every_count_equals_that_of_the_rows():
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


def test_a_histogram_is_cumulative():
    _, body = asyncio.run(fetch())
    assert sample(body, "piezod_tick_lateness_seconds_bucket", le="2e-05") == 1
    assert sample(body, "piezod_tick_lateness_seconds_bucket", le="5e-05") == 1001
    assert sample(body, "piezod_tick_lateness_seconds_bucket", le="+Inf") == 1001
    assert sample(body, "piezod_tick_duration_seconds_sum") == pytest.approx(0.15)


def test_a_value_that_the_device_does_not_have_has_no_sample():
    _, body = asyncio.run(fetch())
    assert "piezod_voltage_readback_volts{" not in body


@pytest.mark.parametrize("request_line", [b"POST /metrics HTTP/1.1\r\n", b"GET /arm HTTP/1.1\r\n", b"x\r\n"])
def test_other_requests_are_answered_with_404(request_line):
    head, _ = asyncio.run(fetch(request_line + b"Host: localhost\r\n\r\n"))
    assert head.startswith("HTTP/1.1 404")


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        ("Host: 127.0.0.1:9100", 200),
        ("Host: LOCALHOST:1", 200),
        ("hOsT:localhost", 200),
        ("Host: localhost:9100\r\nOrigin: http://localhost:9100", 200),
        ("Host: evil.example", 403),
        ("Host: evil.example:9100", 403),
        ("Host: 127.0.0.1.evil.example", 403),
        ("Host: localhost@evil.example", 403),
        ("Host: evil.example@localhost", 403),
        ("Host: [", 403),
        ("Host: ", 403),
        ("X: y", 403),
        ("Host: localhost\r\nHost: evil.example", 403),
        ("Host: evil.example\r\nHost: localhost", 403),
        ("Host: localhost\r\nOrigin: http://evil.example", 403),
        ("Host: localhost\r\nOrigin: null", 403),
    ],
)
def test_a_page_of_another_name_reads_no_metrics(headers, code):
    head, body = asyncio.run(fetch(f"GET /metrics HTTP/1.1\r\n{headers}\r\n\r\n".encode()))
    assert head.startswith(f"HTTP/1.1 {code} ")
    assert ("piezod_force_newtons" in body) == (code == 200)
    assert "Cross-Origin-Resource-Policy: same-origin" in head
    assert "Access-Control" not in head


def test_a_request_that_is_too_long_ends_the_connection():
    assert asyncio.run(fetch(b"GET /metrics HTTP/1.1\r\nX: " + b"y" * 20_000 + b"\r\n\r\n"))[0] == ""


def test_the_server_listens_on_the_loopback_address_and_reports_a_port_in_use():
    async def twice():
        log = []
        first = MetricsServer(BenchMetrics("a", make_statistics()), log.append)
        await first.open(0)
        address = first._server.sockets[0].getsockname()
        assert address[0] == "127.0.0.1"
        second = MetricsServer(BenchMetrics("a", make_statistics()), log.append)
        try:
            await second.open(address[1])
        finally:
            await first.close()

    with pytest.raises(BusyError, match="cannot be bound"):
        asyncio.run(twice())


@pytest.mark.parametrize(("lost", "missed", "error_N"), [(False, 500, 70.0), (True, 0, 5.0)])
def test_lost_rows_are_no_missed_ticks_and_give_no_tracking_error(lost, missed, error_N):
    """Each reading is 5 N above the reference of the row before; the 500 ticks between the parts have no rows."""
    statistics = TickStatistics(lambda *_: None)
    part = rows(10, state=State.RUNNING, result=ExchangeResult.OK, force_N=105.0, reference_N=100.0)
    statistics.add(part)
    if lost:
        statistics.skip_lost_rows()
    later = rows(10, state=State.RUNNING, result=ExchangeResult.OK, force_N=170.0, reference_N=165.0)
    later["tick"] += 510
    statistics.add(later)
    assert statistics.missed == missed
    assert statistics.tracking.max_N == error_N


def test_a_transition_is_reported_once():
    reported = []
    statistics = TickStatistics(lambda state, cause, row: reported.append((state, cause)))
    for state, cause in ((State.DISARMED, Cause.NONE), (State.ARMING, Cause.ARMED), (State.ARMING, Cause.ARMED)):
        statistics.add(rows(5, state=state, cause=cause))
    assert reported == [(State.ARMING, Cause.ARMED)]


def test_counts_of_a_live_reference_are_shown_by_result():
    values = {"accepted": 12, "out_of_range": 3}
    metrics = BenchMetrics("b", make_statistics(), values=lambda: values)
    (family,) = [one for one in metrics.collect() if one.name == "piezod_reference_values"]
    assert {one.labels["result"]: one.value for one in family.samples} == values


def test_the_leaky_counts_of_the_interlocks_are_shown():
    counters = [0] * 64
    counters[8:12] = 951, 6, 9, 12  # force: wrong samples, level, highest, level that trips
    registry = CollectorRegistry(auto_describe=False)
    registry.register(BenchMetrics("b", make_statistics(), counters=lambda: counters))
    body = generate_latest(registry).decode()
    assert sample(body, "piezod_wrong_samples_total", interlock="force") == 951
    assert sample(body, "piezod_interlock_level", interlock="force") == 0.5
    assert sample(body, "piezod_interlock_highest", interlock="force") == 0.75
    assert sample(body, "piezod_wrong_samples_total", interlock="missed_ticks") == 0


def test_the_end_of_the_server_with_connected_clients_reports_nothing(caplog):
    async def end():
        log = []
        server = MetricsServer(BenchMetrics("b", make_statistics()), log.append)
        await server.open(0)
        port = int(log[0].rpartition(":")[2].partition("/")[0])
        clients = [await asyncio.open_connection("127.0.0.1", port) for _ in range(3)]
        await asyncio.sleep(0)
        await server.close()
        for _, writer in clients:
            writer.close()
        await asyncio.sleep(0.01)

    asyncio.run(end())
    assert caplog.records == []


def test_a_failed_exchange_gives_no_value_and_makes_none_younger():
    statistics = TickStatistics(lambda *_: None)
    now_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    statistics.add(rows(1, time_ns=now_ns - 8_000_000_000))
    statistics.add(rows(1, time_ns=now_ns, result=ExchangeResult.TIMEOUT))
    assert statistics.age.age_s == pytest.approx(8.0, abs=0.2)
    assert statistics.age.is_stale(0.01)
    statistics.add(rows(1, time_ns=now_ns))
    assert not statistics.age.is_stale(0.01)


@pytest.mark.parametrize(("age_s", "stale"), [(0.2, 0.0), (1.5, 1.0)])
def test_the_age_of_the_values_is_told(age_s, stale):
    statistics = TickStatistics(lambda *_: None)
    statistics.add(rows(1, time_ns=time.clock_gettime_ns(time.CLOCK_BOOTTIME) - round(1e9 * age_s)))
    body = generate_latest(registry_of(BenchMetrics("b", statistics, dt_s=0.01))).decode()
    assert sample(body, "piezod_age_seconds") == pytest.approx(age_s, abs=0.2)
    assert sample(body, "piezod_stale") == stale


def test_values_are_stale_before_the_first_tick_and_have_no_age():
    body = generate_latest(registry_of(BenchMetrics("b", TickStatistics(lambda *_: None)))).decode()
    assert sample(body, "piezod_stale") == 1.0
    assert "piezod_age_seconds{" not in body


def registry_of(metrics):
    registry = CollectorRegistry()
    registry.register(metrics)
    return registry
