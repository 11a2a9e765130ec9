"""The limits that `piezod latency` suggests hold during the pauses seen, and are a valid bench file."""

import numpy as np
import pytest
import yaml

from piezod.commissioning.shipped_files import shipped
from piezod.commissioning.slow_machine import MARGIN, limits_block, suggested_limits
from piezod.config import load_bench
from piezod.control.latency import Lateness


def lateness(rate_Hz, worst_us, missed=0):
    values = np.full(20_000, 20.0)
    values[100] = worst_us
    return Lateness(rate_Hz, missed, values)


def test_a_fast_machine_keeps_the_limits_of_the_shipped_bench():
    bench = load_bench(shipped("bench.yaml"))
    suggested = suggested_limits([lateness(1000.0, 80.0)])
    assert suggested.pop("rate_Hz") == bench.rate_Hz
    assert suggested == {name: getattr(bench.limits, name) for name in suggested}


@pytest.mark.parametrize("pause_ms", [4.0, 30.0, 250.0])
def test_a_pause_stays_below_each_limit(pause_ms):
    suggested = suggested_limits([lateness(500.0, 1e3 * pause_ms)])
    expected_ms = MARGIN * pause_ms
    assert suggested["missed_ticks_in_a_row"] * 2.0 >= expected_ms  # a tick has 2 ms
    assert suggested["stale_after_ms"] > expected_ms
    assert expected_ms < suggested["device_watchdog_ms"] < suggested["comm_loss_ms"]


def test_the_highest_rate_that_is_held_counts():
    measured = [lateness(500.0, 40.0), lateness(1000.0, 60.0), lateness(2000.0, 900.0, missed=500)]
    assert suggested_limits(measured)["rate_Hz"] == 1000.0
    assert suggested_limits([lateness(500.0, 9e3, missed=900), lateness(200.0, 9e3, missed=900)])["rate_Hz"] == 200.0


@pytest.mark.parametrize("pause_ms", [0.05, 3.0, 60.0, 400.0])
@pytest.mark.parametrize("rate_Hz", [200.0, 1000.0, 4000.0])
def test_the_block_is_valid_in_a_bench_file(tmp_path, rate_Hz, pause_ms):
    block = yaml.safe_load(limits_block(suggested_limits([lateness(rate_Hz, 1e3 * pause_ms)])))
    content = yaml.safe_load(shipped("bench.yaml").read_text(encoding="utf-8"))
    content["limits"] |= block.pop("limits")
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(content | block, sort_keys=False), encoding="utf-8")
    assert load_bench(path).rate_Hz == rate_Hz
