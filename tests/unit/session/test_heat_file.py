"""The heat of the stack between two runs."""

import math
import os

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.session import heat_file
from piezod.session.heat_file import HeatFile


@pytest.fixture
def bench(tmp_path):
    loaded = load_bench(shipped("bench.yaml"))
    return loaded.model_copy(update={"daemon": loaded.daemon.model_copy(update={"ring_log": str(tmp_path / "ring")})})


@pytest.fixture
def clock(monkeypatch):
    now = [1e9]
    monkeypatch.setattr(heat_file.clock, "wall_s", lambda: now[0])
    return now


@pytest.mark.parametrize("age_s", [0.0, 5.0, 100.0])
def test_heat_cools_by_the_clock(bench, clock, age_s):
    HeatFile(bench).keep(1.5)
    clock[0] += age_s
    assert HeatFile(bench).pop() == pytest.approx(1.5 * math.exp(-age_s / bench.limits.dissipation_over_s))


def test_a_run_that_ended_without_a_word_leaves_the_stack_as_hot_as_its_limit(bench, clock):
    HeatFile(bench).keep(0.1)
    HeatFile(bench).pop()
    assert HeatFile(bench).pop() == bench.limits.dissipation_max_W


def test_a_clock_that_was_set_back_cools_nothing(bench, clock):
    HeatFile(bench).keep(1.5)
    clock[0] -= 3600.0
    assert HeatFile(bench).pop() == 1.5


@pytest.mark.parametrize(
    "content", ["", "{}", "[1]", '{"power_W": NaN, "time_s": 1}', '{"power_W": -1, "time_s": 1}', "x" * 5000]
)
def test_a_file_without_sense_counts_as_the_limit(bench, content):
    bench.ring_log_path.with_name("ring.heat").write_text(content, encoding="ascii")
    assert HeatFile(bench).pop() == bench.limits.dissipation_max_W


@pytest.mark.parametrize("kind", ["fifo", "link to a fifo", "link", "folder"])
def test_what_stands_at_the_name_neither_blocks_nor_leads_to_a_foreign_file(bench, clock, kind):
    path, foreign = bench.ring_log_path.with_name("ring.heat"), bench.ring_log_path.with_name("foreign")
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    else:
        os.mkfifo(foreign) if "fifo" in kind else foreign.write_text("mine")
        path.symlink_to(foreign)
    assert HeatFile(bench).pop() == bench.limits.dissipation_max_W
    HeatFile(bench).keep(0.1)
    assert kind != "link" or foreign.read_text() == "mine"
    assert kind == "folder" or not path.is_fifo()
