"""Prometheus metrics on the loopback address, computed from the statistics at each request. Runs in the daemon."""

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterable, Sequence
from email import message_from_bytes
from math import inf

import numpy as np
from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector

from piezod.config.host_name import LOCAL_NAMES, is_permitted
from piezod.control import State
from piezod.control.leaky_count import interlock_counts
from piezod.control.phase_times import PHASES
from piezod.daemon.connections import Connections
from piezod.daemon.drift import DriftWatch
from piezod.daemon.journal import JOURNAL
from piezod.daemon.last_check import LastCheck
from piezod.daemon.learning_watch import LearningWatch
from piezod.daemon.phase_watch import PhaseWatch
from piezod.daemon.proof_date import ProofDate
from piezod.daemon.railed import RailedWatch
from piezod.daemon.statistics import BOUNDS_S, DurationHistogram, TickStatistics
from piezod.errors import BusyError
from piezod.recorder.watch import RecorderWatch
from piezod.runtime import sockets
from piezod.transport import ExchangeResult

ADDRESS = "127.0.0.1"  # only programs on this machine can read the metrics
REQUEST_WITHIN_S = 5.0
LONGEST_REQUEST = 8192
TEXT = "text/plain; charset=utf-8"
MOST_CLIENTS = 8
_GAUGES = {
    "reference_N": ("piezod_reference_newtons", "Last reference force"),
    "force_N": ("piezod_force_newtons", "Last force reading"),
    "voltage_V": ("piezod_voltage_volts", "Last voltage that the device acknowledged"),
    "readback_V": ("piezod_voltage_readback_volts", "Last voltage read-back"),
    "temperature_C": ("piezod_temperature_celsius", "Last temperature reading"),
}
_RECORDER_GAUGES = {
    "degraded": ("1 while ticks are not written to the disk", "degraded"),
    "last_tick": ("Number of the last tick on the disk", "last_tick"),
    "bytes": ("Size of all recordings of this bench", "bytes"),
    "commit_seconds": ("Duration of the longest commit since the previous report", "commit_s"),
}
_RECORDER_COUNTS = {
    "rows": "Ticks written to the disk",
    "dropped": "Ticks overwritten before they were written to the disk",
    "failures": "Files abandoned because of an error",
    "restarts": "Restarts of the recorder process",
}


class BenchMetrics(Collector):
    """Metrics of one bench.

    Parameters
    ----------
    name
        Name of the bench, a label of every metric.
    recorder
        Recorder; None without one.
    drift
        Function that returns the present comparison with the model; it returns None without one.
    railed
        Watch for a reference out of reach; None without one.
    values
        Function that returns the counts of a live reference by result; it returns None without one.
    phases
        Durations of the phases of a tick; None without them.
    learning
        Function that returns the present learning of a looped reference; it returns None without one.
    dt_s
        Time between two ticks [s].
    proof
        Last proof test; None: it is not watched.
    counters
        Function that returns the counters of the ring log; it returns none without a control process.
    last_check
        Last check of the model with a recorded drive; None: without one.
    """

    def __init__(
        self,
        name: str,
        statistics: TickStatistics,
        recorder: RecorderWatch | None = None,
        drift: Callable[[], DriftWatch | None] = lambda: None,
        railed: RailedWatch | None = None,
        values: Callable[[], dict[str, int] | None] = lambda: None,
        phases: PhaseWatch | None = None,
        learning: Callable[[], LearningWatch | None] = lambda: None,
        dt_s: float = 0.0,
        proof: ProofDate | None = None,
        counters: Callable[[], Sequence[int]] = lambda: (),
        last_check: LastCheck | None = None,
    ) -> None:
        self._last_check = last_check
        self._counters = counters
        self._proof = proof
        self._dt_s = dt_s
        self._labels = [name]
        self._statistics = statistics
        self._recorder = recorder
        self._drift = drift
        self._railed, self._phases = railed, phases
        self._values = values
        self._learning = learning

    def _age_metrics(self) -> Iterable[Metric]:
        age = self._statistics.age
        proof_s = None if self._proof is None else self._proof.age_s
        for name, text, value in (
            ("piezod_age_seconds", "Time since the last good exchange; absent before the first one", age.age_s),
            ("piezod_stale", "1 while the values are older than a second and three ticks", age.is_stale(self._dt_s)),
            ("piezod_proof_age_seconds", "Time since the last proof test that was passed; absent without one", proof_s),
            ("piezod_log_lines_dropped", "Log lines that nobody read in time", JOURNAL.dropped),
        ):
            gauge = GaugeMetricFamily(name, text, labels=["bench"])
            if value is not None:
                gauge.add_metric(self._labels, float(value))
            yield gauge

    def collect(self) -> Iterable[Metric]:
        """Yield all metrics with their present values."""
        statistics = self._statistics
        yield self._states()
        yield from self._age_metrics()
        for field, (name, text) in _GAUGES.items():
            gauge = GaugeMetricFamily(name, text, labels=["bench"])
            if statistics.last is not None and np.isfinite(statistics.last[field]):
                gauge.add_metric(self._labels, float(statistics.last[field]))
            yield gauge
        yield self._count("piezod_ticks", "Ticks run", statistics.ticks)
        yield self._count("piezod_missed_ticks", "Ticks skipped because an earlier tick was late", statistics.missed)
        yield self._count("piezod_transitions", "State transitions", statistics.transitions)
        exchanges = CounterMetricFamily("piezod_exchanges", "Exchanges by result", labels=["bench", "result"])
        for result in ExchangeResult:
            exchanges.add_metric([*self._labels, result.name.lower()], float(statistics.results[result]))
        yield exchanges
        faults = CounterMetricFamily("piezod_faults", "Latched faults by cause", labels=["bench", "cause"])
        for cause, count in statistics.faults.items():
            faults.add_metric([*self._labels, cause], count)
        yield faults
        yield self._histogram("piezod_tick_lateness_seconds", "Wake-up after the deadline", statistics.lateness)
        yield self._histogram("piezod_tick_duration_seconds", "From wake-up to evaluated reading", statistics.exchange)
        yield from self._interlock_metrics()
        if self._recorder is not None:
            yield from self._recorder_metrics(self._recorder)
        yield from self._drift_metrics()
        yield from self._check_metrics()
        yield from self._learning_metrics()
        if self._railed is not None:
            text = "1 while the reference is out of reach because the voltage is at a limit"
            gauge = GaugeMetricFamily("piezod_railed", text, labels=["bench"])
            gauge.add_metric(self._labels, float(self._railed.railed))
            yield gauge
        if (values := self._values()) is not None:
            text = "Values of a live reference by result of their check"
            counter = CounterMetricFamily("piezod_reference_values", text, labels=["bench", "result"])
            for name, count in values.items():
                counter.add_metric([*self._labels, name], count)
            yield counter
        if self._phases is not None:
            yield self._phase_histogram(self._phases)

    def _phase_histogram(self, phases: PhaseWatch) -> Metric:
        text = "Duration of a phase of a tick that writes a voltage"
        histogram = HistogramMetricFamily("piezod_phase_seconds", text, labels=["bench", "phase"])
        for name, durations in zip(PHASES, phases.histograms, strict=True):
            histogram.add_metric([*self._labels, name], _buckets(durations), durations.sum_s)
        return histogram

    def _interlock_metrics(self) -> Iterable[Metric]:
        labels, share = ["bench", "interlock"], "as share of the level that trips"
        wrong = CounterMetricFamily("piezod_wrong_samples", "Wrong samples of a debounced interlock", labels=labels)
        level = GaugeMetricFamily("piezod_interlock_level", f"Leaky count of wrong samples, {share}", labels=labels)
        highest = GaugeMetricFamily("piezod_interlock_highest", f"Highest level since arming, {share}", labels=labels)
        for name, count in interlock_counts(self._counters()).items():
            wrong.add_metric([*self._labels, name], count["wrong"])
            level.add_metric([*self._labels, name], count["level"])
            highest.add_metric([*self._labels, name], count["highest"])
        return wrong, level, highest

    def _drift_metrics(self) -> Iterable[Metric]:
        watch = self._drift()
        if watch is None:
            return
        for name, (text, value) in {
            "piezod_corrected_force_newtons": ("Last force, corrected for the load cell", watch.corrected_N),
            "piezod_model_error_newtons": ("Rms difference of force and model in the last window", watch.rms_N),
            "piezod_model_offset_newtons": (
                "Mean difference, relative to the first window",
                watch.offset_N,
            ),
            "piezod_model_drifted": ("1 after the bench has left its model", float(watch.drifted)),
            "piezod_model_evidence": (
                "Evidence of a change, as share of the level of the alarm",
                1.0 if watch.drifted else watch.test.alarm.evidence / watch.test.alarm.level,
            ),
            "piezod_model_known_windows": (
                "Windows that later ones are compared with",
                float(watch.test.reference.size),
            ),
            "piezod_model_input_outside": (
                "1 while the input is unlike what was driven before, so that it is not compared",
                float(bool(watch.outside)),
            ),
        }.items():
            gauge = GaugeMetricFamily(name, text, labels=["bench"])
            if np.isfinite(value):
                gauge.add_metric(self._labels, value)
            yield gauge

    def _check_metrics(self) -> Iterable[Metric]:
        check = None if self._last_check is None else self._last_check.as_dict()
        if check is None:
            return
        for name, text, value in (
            ("piezod_check_age_seconds", "Age of the drive of the last check of the model", float(check["age_s"])),
            ("piezod_check_matches", "1 if the last check found that the model holds", check["verdict"] == "matches"),
        ):
            gauge = GaugeMetricFamily(name, text, labels=["bench"])
            gauge.add_metric(self._labels, float(value))
            yield gauge

    def _learning_metrics(self) -> Iterable[Metric]:
        watch = self._learning()
        if watch is None:
            return
        yield self._count("piezod_learned_passes", "Passes of a looped reference that were learned from", watch.passes)
        gauge = GaugeMetricFamily(
            "piezod_learning_error_newtons",
            "Rms tracking error of the last pass of a looped reference",
            labels=["bench"],
        )
        if watch.passes:
            gauge.add_metric(self._labels, watch.errors_N[-1])
        yield gauge

    def _recorder_metrics(self, recorder: RecorderWatch) -> Iterable[Metric]:
        status = recorder.as_dict()
        for name, (text, key) in _RECORDER_GAUGES.items():
            gauge = GaugeMetricFamily(f"piezod_recorder_{name}", text, labels=["bench"])
            gauge.add_metric(self._labels, float(status[key]))
            yield gauge
        for key, text in _RECORDER_COUNTS.items():
            yield self._count(f"piezod_recorder_{key}", text, status[key])

    def _states(self) -> Metric:
        gauge = GaugeMetricFamily("piezod_state", "1 for the present state of the bench", labels=["bench", "state"])
        for state in State:
            gauge.add_metric([*self._labels, state.name.lower()], float(state is self._statistics.state))
        return gauge

    def _count(self, name: str, text: str, value: int) -> Metric:
        counter = CounterMetricFamily(name, text, labels=["bench"])
        counter.add_metric(self._labels, value)
        return counter

    def _histogram(self, name: str, text: str, durations: DurationHistogram) -> Metric:
        histogram = HistogramMetricFamily(name, text, labels=["bench"])
        histogram.add_metric(self._labels, _buckets(durations), durations.sum_s)
        return histogram


def _buckets(durations: DurationHistogram) -> list[tuple[str, float]]:
    """Cumulated counts by upper bound, as Prometheus expects them."""
    below = np.cumsum(durations.counts)
    return [
        ("+Inf" if bound == inf else repr(bound), float(n)) for bound, n in zip((*BOUNDS_S, inf), below, strict=True)
    ]


class MetricsServer:
    """HTTP server that answers `GET /metrics` under a local name and no other request.

    Parameters
    ----------
    log
        Called with one line about the address when the server listens.
    """

    def __init__(self, collector: Collector, log: Callable[[str], None]) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(collector)
        self._log = log
        self._clients = 0
        self._connections = Connections(self._serve)
        self._server: asyncio.Server | None = None

    async def open(self, port: int) -> None:
        """Listen.

        Parameters
        ----------
        port
            TCP port; 0: any free port.

        Raises
        ------
        BusyError
            Another program uses the port.
        """
        listener = sockets.socket(socket.AF_INET, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((ADDRESS, port))
            listener.setblocking(False)
            self._server = await asyncio.start_server(self._connections.accept, sock=listener, limit=LONGEST_REQUEST)
        except OSError as error:
            listener.close()
            raise BusyError(
                f"daemon.metrics_port: {ADDRESS}:{port} cannot be bound: {error.strerror}; choose another port"
            ) from error
        self._log(f"metrics: http://{ADDRESS}:{self._server.sockets[0].getsockname()[1]}/metrics")

    async def close(self) -> None:
        """Close the server."""
        if self._server is not None:
            await self._connections.close(self._server)

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
        line, _, rest = request.partition(b"\r\n")
        headers = message_from_bytes(rest)
        hosts = headers.get_all("Host", [])
        if len(hosts) != 1 or not is_permitted(str(hosts[0]), headers.get("Origin"), LOCAL_NAMES):
            return _response("403 Forbidden", TEXT, f"the host must be {' or '.join(LOCAL_NAMES)}\n".encode())
        method, _, rest = line.partition(b" ")
        path = rest.partition(b" ")[0].partition(b"?")[0]
        if method != b"GET" or path not in (b"/", b"/metrics"):
            return _response("404 Not Found", TEXT, b"GET /metrics\n")
        return _response("200 OK", CONTENT_TYPE_LATEST, generate_latest(self._registry))


def _response(status: str, kind: str, body: bytes) -> bytes:
    head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n"
    head += "X-Content-Type-Options: nosniff\r\nCross-Origin-Resource-Policy: same-origin\r\n\r\n"
    return head.encode("ascii") + body
