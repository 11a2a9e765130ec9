"""A reference that is out of reach: when it is reported, and how often."""

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.control import ROW_DTYPE, State
from piezod.daemon.metrics import BenchMetrics
from piezod.daemon.railed import RailedWatch
from piezod.daemon.statistics import TickStatistics

BENCH = load_bench(shipped("bench.yaml"))  # 0 to 140 V, 1 kHz, railed after 1 s


def rows(count, planned_V, state=State.RUNNING):
    made = np.zeros(count, ROW_DTYPE)
    made["planned_V"], made["state"] = planned_V, state
    return made


@pytest.fixture
def watched():
    lines = []
    return RailedWatch(lines.append), lines


@pytest.mark.parametrize(("planned_V", "name"), [(158.0, "voltage_max_V is 140 V"), (-5.0, "voltage_min_V is 0 V")])
def test_a_voltage_beyond_its_range_for_longer_than_the_time_is_reported_once(watched, planned_V, name):
    watch, lines = watched
    for _ in range(10):
        watch.add(rows(100, planned_V), BENCH)
    assert not watch.railed
    for _ in range(10):
        watch.add(rows(100, planned_V), BENCH)
    assert watch.as_dict() == {"railed": True, "lasted_s": 2.0}
    assert len(lines) == 1
    assert name in lines[0]
    assert "\n" not in lines[0]


def test_a_break_ends_it_and_only_the_next_arming_reports_it_again(watched):
    watch, lines = watched
    watch.add(rows(1500, 158.0), BENCH)
    watch.add(rows(1, 100.0), BENCH)
    assert not watch.railed
    watch.add(rows(1500, 158.0), BENCH)
    assert (watch.railed, len(lines)) == (True, 1)
    watch.add(rows(10, 0.0, State.ARMING), BENCH)
    watch.add(rows(1500, 158.0), BENCH)
    assert (watch.railed, len(lines)) == (True, 2)


@pytest.mark.parametrize(
    ("planned_V", "state"), [(140.0, State.RUNNING), (0.0, State.RUNNING), (np.nan, State.RUNNING), (158.0, State.HOLD)]
)
def test_a_voltage_at_the_end_of_its_range_or_without_a_reference_is_not_railed(watched, planned_V, state):
    watch, lines = watched
    watch.add(rows(5000, planned_V, state), BENCH)
    assert (watch.railed, lines) == (False, [])


def test_the_metric_follows_the_watch(watched):
    watch, _ = watched
    metrics = BenchMetrics("b", TickStatistics(lambda *_: None), railed=watch)

    def value():
        (family,) = [one for one in metrics.collect() if one.name == "piezod_railed"]
        return family.samples[0].value

    assert value() == 0.0
    watch.add(rows(1500, 158.0), BENCH)
    assert value() == 1.0
