"""Histograms of the phases of a tick."""

import multiprocessing
import sys
from time import perf_counter_ns as time_ns

import numpy as np
import pytest

from piezod.control import Segment, TableReference
from piezod.control.phase_times import CAPACITY, CELLS, PHASES, PhaseReader, PhaseTimes
from piezod.daemon.metrics import BenchMetrics
from piezod.daemon.phase_watch import PhaseWatch
from piezod.daemon.statistics import TickStatistics
from piezod.session.session import PHASE_CELLS
from tests.unit.control.fake_bench import FakeLink
from tests.unit.control.loops import Halving, armed_loop, make_loop, run


def test_another_view_of_the_memory_reads_each_tick_once():
    memory = multiprocessing.RawArray("q", CELLS)
    times, reader = PhaseTimes(memory), PhaseReader(memory)
    assert reader.read().shape == (0, 5)
    times.add_tick(100, 110, 130, 10_130, 10_170, 10_177)
    times.add_tick(0, 1, 3, 6, 10, 15)
    np.testing.assert_array_equal(reader.read(), [[10, 20, 10_000, 40, 7], [1, 2, 3, 4, 5]])
    assert reader.read().shape == (0, 5)
    assert PHASE_CELLS == CELLS


def test_a_late_reader_gets_the_newest_ticks():
    times = PhaseTimes()
    reader = PhaseReader(times.memory)
    for k in range(2 * CAPACITY + 7):
        times.add_tick(0, k, k, k, k, k)
    np.testing.assert_array_equal(reader.read()[:, 0], np.arange(CAPACITY + 8, 2 * CAPACITY + 7))


def test_every_tick_that_drives_adds_to_each_phase_and_a_disarmed_one_to_none(ring_log):
    loop = make_loop(FakeLink(), ring_log)
    reader = PhaseReader(loop._phases.memory)
    run(loop, 50)
    assert reader.read().shape == (0, 5)
    loop.arm(Segment("work", TableReference(np.full(10**4, 60.0)), Halving()))
    run(loop, 200)
    durations = reader.read()
    assert durations.shape == (200, 5)
    assert (durations >= 0).all()


def test_the_phases_fill_the_tick_and_a_slow_exchange_shows_in_its_phase_only(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    exchange = link.exchange

    def slow(voltage_V):
        end_ns = time_ns() + 3_000_000
        while time_ns() < end_ns:
            pass
        return exchange(voltage_V)

    link.exchange = slow
    run(loop, 1)
    (durations,) = PhaseReader(loop._phases.memory).read()
    assert durations[PHASES.index("exchange")] >= 3_000_000
    assert durations.argmax() == PHASES.index("exchange")


def test_a_written_tick_leaves_no_object_behind():
    times = PhaseTimes()
    for _ in range(100):
        times.add_tick(0, 1000, 3000, 200_000, 300_000, 400_000)
    before = sys.getallocatedblocks()
    for _ in range(10_000):
        times.add_tick(0, 1000, 3000, 200_000, 300_000, 400_000)
    assert sys.getallocatedblocks() - before < 20


@pytest.fixture
def watched():
    lines, times = [], PhaseTimes()
    watch = PhaseWatch(lines.append)
    watch.begin(times.memory)
    return watch, times, lines


def test_a_slow_phase_is_logged_once_and_only_with_a_limit(watched):
    watch, times, lines = watched
    for slow_ms, count in ((None, 0), (6.1, 0), (5.0, 1), (5.0, 1)):
        times.add_tick(0, 0, 0, 6_000_000, 6_000_000, 6_000_000)
        watch.add_new(slow_ms)
        assert len(lines) == count
    assert "phase exchange lasted 6.00 ms, daemon.slow_phase_ms is 5" in lines[0]


def test_status_and_metrics_show_the_histograms(watched):
    watch, times, _ = watched
    assert watch.as_dict()["plan"]["mean_us"] is None
    for duration_ns in (*[3000] * 99, 1_000_001):
        times.add_tick(0, 0, duration_ns, duration_ns, duration_ns, duration_ns)
    watch.add_new(None)
    plan = watch.as_dict()["plan"]
    assert (plan["mean_us"], plan["max_us"], sum(plan["counts"])) == (12.97, 1000.0, 100)
    assert plan["counts"][0] == 99  # below 10 us
    assert plan["counts"][7] == 1  # 1 to 2 ms
    metrics = BenchMetrics("b", TickStatistics(lambda *_: None), phases=watch)
    (family,) = [one for one in metrics.collect() if one.name == "piezod_phase_seconds"]
    found = {
        one.labels["le"]: one.value
        for one in family.samples
        if one.labels["phase"] == "plan" and one.name.endswith("_bucket")
    }
    assert (found["1e-05"], found["0.001"], found["0.002"], found["+Inf"]) == (99.0, 99.0, 100.0, 100.0)
