"""Faults of a reference: stale, wild, forged or absurd values of a stream and of a file."""

import contextlib
import hmac
import socket
import struct
import threading
import time

import numpy as np
import yaml

from tests.faults.bench_pool import Observation, run_piezod
from tests.faults.live_bench import LiveBench
from tests.faults.running_faults import Watch

FORCE_N = 120.0
KEY = bytes(range(32))


class Sender:
    """Sends datagrams to a unix socket, also in a thread of its own.

    Parameters
    ----------
    path
        Path of the socket.
    key, session
        Shared key and session number; without a key datagrams carry neither session nor tag.
    """

    def __init__(self, path, key=None, session=1):
        self._path, self._key, self.session = str(path), key, session
        self.sequence = 0
        self._ended = threading.Event()
        self._thread = None

    def send(self, value_N, sequence=None):
        """Send one datagram; by default with the next sequence number."""
        self.sequence = self.sequence + 1 if sequence is None else sequence
        body = struct.pack("<QQd", self.sequence, time.time_ns(), value_N)
        if self._key is not None:
            body = struct.pack("<Q", self.session) + body
            body += hmac.new(self._key, body, "sha256").digest()[:16]
        self.send_bytes(body)
        return body

    def send_bytes(self, body):
        """Send any bytes."""
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
            client.setblocking(False)
            client.sendto(body, self._path)

    def start(self, value_N=FORCE_N):
        """Send a value 100 times a second until `stop`."""

        def run():
            while not self._ended.wait(0.01):
                self.send(value_N)

        self._ended.clear()
        self._thread = threading.Thread(target=run)
        self._thread.start()

    def stop(self):
        """End the thread."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None


@contextlib.contextmanager
def _streamed_bench(pool):
    """A bench that follows a stream, and the path of its socket."""
    folder = pool.new_folder()
    path = folder / "stream"
    reference = {"kind": "stream", "listen": str(path), "stale_after_s": 0.2, "when_stale": "hold"}
    bench = LiveBench(folder, None, {"reference": reference})
    try:
        bench.restore()
        yield bench, path
    finally:
        bench.close()


def _end(bench, observed):
    """Disarm a bench in any state."""
    with contextlib.suppress(Exception):
        bench.send_command("disarm")
    bench.wait_state("DISARMED", "FAULT")
    bench.restore()
    observed.armings = bench.rearms
    return observed


def wild_datagrams(pool, fault, *, numbers=(), values=(), junk=0, seed=1, for_s=1.0):
    """Send wild sequence numbers, absurd values or random bytes beside a good sender, while the bench drives."""
    random = np.random.default_rng(seed)
    with _streamed_bench(pool) as (bench, path):
        sender = Sender(path)
        sender.start()
        try:
            bench.arm()
            watch, observed = Watch(bench), Observation()
            for number in numbers:
                Sender(path).send(FORCE_N, number)
            for value_N in values:
                Sender(path).send(value_N, sender.sequence + 1)
                time.sleep(0.03)
            for _ in range(junk):
                Sender(path).send_bytes(random.bytes(24))
                time.sleep(0.005)
            watch.until(fault.expect.states, for_s, fault.within_ms)
            watch.finish(observed)
            _count(bench, watch, observed)
        finally:
            sender.stop()
        return _end(bench, observed)


def _count(bench, watch, observed):
    rows = np.concatenate(watch.parts)
    refused = bench.status().get("reference_values") or {}
    observed.figures["reference_off_N"] = float(np.abs(rows["reference_N"] - FORCE_N).max())
    observed.figures["refused"] = sum(count for name, count in refused.items() if name != "accepted")


def absurd_file(pool, fault, *, value=100.0, gap_s=0.0, cut=0):
    """Start with a reference file that has one wrong value, a gap before its last row, or a last line cut short."""
    bench = pool.bench()
    bench.service.end()
    bench.drop()
    folder = pool.new_folder()
    rows = [f"{k / 100 + gap_s * (k == 99)},{value if k == 50 else 100.0}" for k in range(100)]
    text = "time_s,reference_N\n" + "\n".join(rows) + "\n"
    (folder / "reference.csv").write_text(text[: len(text) - cut], encoding="utf-8")
    content = yaml.safe_load(bench.path.read_text(encoding="utf-8"))
    content["reference"] = {"kind": "file", "path": str(folder / "reference.csv")}
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    bench.device.ask("mark")
    code, text, after_ms = run_piezod("run", path, "--arm")
    report = bench.device.ask("report")
    observed = Observation("DISARMED", code, text, after_ms, wrong=report["wrong"])
    observed.figures = {"commands": report["commands"], "highest_V": report["highest_V"] or 0.0}
    bench.restore()
    return observed


INJECTORS = {
    "wild_datagrams": wild_datagrams,
    "absurd_file": absurd_file,
}
