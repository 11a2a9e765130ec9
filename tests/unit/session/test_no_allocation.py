"""Ticks of the whole loop, with the real clock, sockets and ring log, allocate no memory that remains."""

import contextlib
import gc
import sys
import tracemalloc

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config.reference import WaveformReference
from piezod.control import PhaseTimes, RealRateKeeper, RingLog, State
from piezod.session.assembly import load_bench_and_model, make_loop, make_segment, opened_link
from piezod.session.task import SegmentSpec
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.exchange import link_config
from tests.benchmarks.memory import growth, traced_bytes

RATE_HZ = 500.0
WARM_UP, PASS, PASSES = 600, 250, 4  # ticks until the reference is followed; ticks that count
PATIENT = {"missed_ticks_in_a_row": 10_000, "stale_after_ms": 5000.0, "comm_loss_ms": 20_000.0,
           "device_watchdog_ms": 10_000}  # fmt: skip
"""Limits that a busy machine does not reach."""
NUMBERS = 8
"""Blocks of numbers that the loop holds: one above 256 is an object, a smaller one is not."""
NUMBER_BYTES = 32


@contextlib.contextmanager
def driven_loop(kind, folder):
    """A loop that follows a sine on the emulated bench."""
    path = shipped("bench.yaml")
    bench, model = load_bench_and_model(path)
    reference = WaveformReference(kind="sine", amplitude_N=40, offset_N=120, frequency_Hz=1.0)
    with peers.emulator(kind, "real") as address, contextlib.ExitStack() as stack:
        limits = bench.limits.model_copy(update=PATIENT)
        bench = bench.model_copy(update={"link": link_config(address), "rate_Hz": RATE_HZ, "limits": limits})
        link = stack.enter_context(opened_link(bench))
        ring_log = RingLog(folder / "ring", 1000)
        stack.callback(ring_log.close)
        loop = make_loop(bench, link, RealRateKeeper(bench.dt_s), ring_log, PhaseTimes())
        link.poll()
        spec = SegmentSpec("sine", "inverse", reference, reset_cycle=False)
        loop.arm(make_segment(spec, bench, model, link, path.parent))
        yield loop


@pytest.fixture
def _frozen():
    """Garbage collector frozen and off, as in the control process; allocations are traced."""
    gc.collect()
    gc.freeze()
    gc.disable()
    tracemalloc.start()
    yield
    tracemalloc.stop()
    gc.unfreeze()
    gc.enable()


@pytest.mark.usefixtures("_frozen")
@pytest.mark.parametrize(("count", "most"), [(sys.getallocatedblocks, NUMBERS), (traced_bytes, NUMBERS * NUMBER_BYTES)])
@pytest.mark.parametrize("kind", ["tcp", "rtu"])
def test_ticks_of_the_loop_allocate_no_memory_that_remains(tmp_path, kind, count, most):
    with driven_loop(kind, tmp_path) as loop:

        def tick(_):
            loop.run_tick()
            loop.wait()

        for number in range(WARM_UP):
            tick(number)
        grown = growth(tick, range(PASS), PASSES, count)
        assert loop.supervisor.state is State.RUNNING
        assert loop.failure == ""
    assert abs(grown) <= most
