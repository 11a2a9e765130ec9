"""Prometheus metrics on the loopback address, made from the tally when they are asked for; no tick knows of it."""

import asyncio
import contextlib
from collections.abc import Callable, Iterable
from math import inf

import numpy as np
from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector

from piezod.control import State
from piezod.daemon.drift import DriftWatch
from piezod.daemon.statistics import BOUNDS_S, Durations, Tally
from piezod.errors import BusyError
from piezod.recorder.watch import RecorderWatch
from piezod.transport import ExchangeResult

ADDRESS = "127.0.0.1"  # read by whoever has an account here, and by nobody else
REQUEST_WITHIN_S = 5.0
LONGEST_REQUEST = 8192
MOST_CLIENTS = 8
_GAUGES = {
    "reference_N": ("piezod_reference_newtons", "Force wanted last"),
    "force_N": ("piezod_force_newtons", "Force read last"),
    "voltage_V": ("piezod_voltage_volts", "Voltage the device acknowledged last"),
    "readback_V": ("piezod_voltage_readback_volts", "Voltage read back last"),
    "temperature_C": ("piezod_temperature_celsius", "Temperature read last"),
}
_RECORDER_GAUGES = {
    "degraded": ("1 while ticks do not come to the disk", "degraded"),
    "last_tick": ("Number of the last tick on the disk", "last_tick"),
    "bytes": ("What the recordings of this bench take", "bytes"),
    "commit_seconds": ("How long the last commit took", "commit_s"),
}
_RECORDER_COUNTS = {
    "rows": "Ticks brought to the disk",
    "dropped": "Ticks overwritten before they came to the disk",
    "failures": "Files given up because of an error",
    "restarts": "Recorder processes started again",
}


class BenchMetrics(Collector):
    """What is shown of one bench.

    Parameters
    ----------
    name
        The bench's, a label of every metric.
    tally
        What the ring log told.
    recorder
        What keeps the ticks; None where nothing does.
    drift
        Returns what compares the bench with its model; None where nothing does.
    """

    def __init__(
        self,
        name: str,
        tally: Tally,
        recorder: RecorderWatch | None = None,
        drift: Callable[[], DriftWatch | None] = lambda: None,
    ) -> None:
        self._labels = [name]
        self._tally = tally
        self._recorder = recorder
        self._drift = drift

    def collect(self) -> Iterable[Metric]:
        """Everything, as it is now."""
        tally = self._tally
        yield self._states()
        for field, (name, text) in _GAUGES.items():
            gauge = GaugeMetricFamily(name, text, labels=["bench"])
            if tally.last is not None and np.isfinite(tally.last[field]):
                gauge.add_metric(self._labels, float(tally.last[field]))
            yield gauge
        yield self._count("piezod_ticks", "Ticks run", tally.ticks)
        yield self._count("piezod_missed_ticks", "Ticks skipped because one before was late", tally.missed)
        yield self._count("piezod_transitions", "State transitions", tally.transitions)
        exchanges = CounterMetricFamily("piezod_exchanges", "Exchanges by result", labels=["bench", "result"])
        for result in ExchangeResult:
            exchanges.add_metric([*self._labels, result.name.lower()], float(tally.results[result]))
        yield exchanges
        faults = CounterMetricFamily("piezod_faults", "Latched faults by cause", labels=["bench", "cause"])
        for cause, count in tally.faults.items():
            faults.add_metric([*self._labels, cause], count)
        yield faults
        yield self._histogram("piezod_tick_lateness_seconds", "Wake-up after the deadline", tally.lateness)
        yield self._histogram("piezod_tick_duration_seconds", "From wake-up to judged reading", tally.exchange)
        if self._recorder is not None:
            yield from self._recorded(self._recorder)
        yield from self._drifted()

    def _drifted(self) -> Iterable[Metric]:
        watch = self._drift()
        if watch is None:
            return
        for name, (text, value) in {
            "piezod_corrected_force_newtons": ("Force behind the last reading", watch.corrected_N),
            "piezod_model_error_newtons": ("Rms of force against model in the last window", watch.rms_N),
            "piezod_model_offset_newtons": ("Mean of it against the first window", watch.offset_N),
            "piezod_model_drifted": ("1 since the bench has left its model", float(watch.drifted)),
        }.items():
            gauge = GaugeMetricFamily(name, text, labels=["bench"])
            if np.isfinite(value):
                gauge.add_metric(self._labels, value)
            yield gauge

    def _recorded(self, recorder: RecorderWatch) -> Iterable[Metric]:
        said = recorder.as_dict()
        for name, (text, key) in _RECORDER_GAUGES.items():
            gauge = GaugeMetricFamily(f"piezod_recorder_{name}", text, labels=["bench"])
            gauge.add_metric(self._labels, float(said[key]))
            yield gauge
        for key, text in _RECORDER_COUNTS.items():
            yield self._count(f"piezod_recorder_{key}", text, said[key])

    def _states(self) -> Metric:
        gauge = GaugeMetricFamily("piezod_state", "1 for the state the bench is in", labels=["bench", "state"])
        for state in State:
            gauge.add_metric([*self._labels, state.name.lower()], float(state is self._tally.state))
        return gauge

    def _count(self, name: str, text: str, value: int) -> Metric:
        counter = CounterMetricFamily(name, text, labels=["bench"])
        counter.add_metric(self._labels, value)
        return counter

    def _histogram(self, name: str, text: str, durations: Durations) -> Metric:
        below = np.cumsum(durations.counts)
        buckets = [
            ("+Inf" if bound == inf else repr(bound), float(n))
            for bound, n in zip((*BOUNDS_S, inf), below, strict=True)
        ]
        histogram = HistogramMetricFamily(name, text, labels=["bench"])
        histogram.add_metric(self._labels, buckets, durations.sum_s)
        return histogram


class MetricsServer:
    """Answers `GET /metrics` and nothing else.

    Parameters
    ----------
    collector
        What is shown.
    log
        Called with the address, once it is known.
    """

    def __init__(self, collector: Collector, log: Callable[[str], None]) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(collector)
        self._log = log
        self._clients = 0
        self._server: asyncio.Server | None = None

    async def open(self, port: int) -> None:
        """Listen; port 0 takes a free one.

        Raises
        ------
        BusyError
            The port is taken.
        """
        try:
            self._server = await asyncio.start_server(self._serve, ADDRESS, port, limit=LONGEST_REQUEST)
        except OSError as error:
            raise BusyError(f"daemon.metrics_port: {ADDRESS}:{port} cannot be bound: {error.strerror}") from error
        self._log(f"metrics: http://{ADDRESS}:{self._server.sockets[0].getsockname()[1]}/metrics")

    async def close(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients += 1
        try:
            if self._clients <= MOST_CLIENTS:
                async with asyncio.timeout(REQUEST_WITHIN_S):
                    writer.write(self._answer(await reader.readuntil(b"\r\n\r\n")))
                    await writer.drain()
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
        finally:
            self._clients -= 1
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    def _answer(self, request: bytes) -> bytes:
        method, _, rest = request.partition(b" ")
        path = rest.partition(b" ")[0].partition(b"?")[0]
        if method != b"GET" or path not in (b"/", b"/metrics"):
            return _response("404 Not Found", "text/plain; charset=utf-8", b"GET /metrics\n")
        return _response("200 OK", CONTENT_TYPE_LATEST, generate_latest(self._registry))


def _response(status: str, kind: str, body: bytes) -> bytes:
    head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return head.encode("ascii") + body
