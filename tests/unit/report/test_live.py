"""The live page behind the browser: a short memory of the ring log, and what the lamp says of it."""

import re
import time

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.control import ROW_DTYPE, Cause, RingLog, State
from piezod.errors import ConfigurationError
from piezod.report.figures.durations import EDGES_us, RecentDurations
from piezod.report.live.curves import Curves, Table
from piezod.report.live.feed import MOST_EVENTS, Feed
from piezod.report.live.server import read_token
from piezod.report.live.status_banner import events_html, lamp_html, state_words


def rows_of(count, first=0, **fields):
    rows = np.zeros(count, ROW_DTYPE)
    rows["tick"] = first + np.arange(count)
    rows["time_ns"] = (first + np.arange(count)) * 1_000_000
    rows["state"] = State.RUNNING
    for name, values in fields.items():
        rows[name] = values
    return rows


@pytest.fixture
def bench(tmp_path):
    path = tmp_path / "bench.yaml"
    text = shipped("bench.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("/dev/shm/piezod-{name}.ring", str(tmp_path / "ring")), encoding="utf-8")
    return load_bench(path)


def ring_of(bench, rows):
    log = RingLog(bench.ring_log_path, 1000)
    for row in rows:
        log.append(*row.tolist())
    return log


def test_a_table_keeps_the_newest_points_and_hands_out_what_is_new():
    table = Table(("x",), 5)
    table.add({"x": np.arange(4.0)})
    table.add({"x": np.arange(4.0, 8.0)})
    assert table.since(0)["x"].tolist() == [3, 4, 5, 6, 7]
    assert table.since(6)["x"].tolist() == [6, 7]
    assert table.since(8)["x"].size == 0


@pytest.mark.parametrize("pieces", [[1000], [1] * 1000, [7, 493, 500]])
def test_a_spike_of_one_tick_is_drawn_however_the_rows_come(pieces):
    curves = Curves(1000.0, 0.05, 30.0, 20.0, 2400)
    force = np.zeros(1000)
    force[321] = 5.0
    begun = 0
    for size in pieces:
        curves.add(rows_of(size, begun, force_N=force[begun : begun + size]), 0.0)
        begun += size
    drawn = curves.over_time.since(0)
    assert drawn["force_N"].size < 50
    assert drawn["force_N"].max() == 5.0
    at_ms = drawn["time_ms"][np.argmax(drawn["force_N"])]
    assert abs(at_ms - 321) <= 50


def test_curves_do_not_grow_with_time():
    curves = Curves(1000.0, 0.05, 2.0, 20.0, 100)
    for k in range(50):
        curves.add(rows_of(1000, 1000 * k, voltage_V=np.arange(1000)), 0.0)
    assert curves.over_time.since(0)["time_ms"].size == 2 * 2 * 20
    assert curves.loop.since(0)["force_N"].size == 100


def test_a_force_belongs_to_the_command_one_row_before():
    curves = Curves(10.0, 0.05, 30.0, 1000.0, 10_000)
    curves.add(rows_of(4, voltage_V=[1, 2, 3, 4], force_N=[0, 10, 20, 30], reference_N=[9, 18, 27, 36]), 0.0)
    loop = curves.loop.since(0)
    assert list(zip(loop["voltage_V"], loop["force_N"], strict=True)) == [(1, 10), (2, 20), (3, 30)]
    assert curves.over_time.since(0)["error_N"].tolist() == [1, 2, 3]


def test_a_failed_exchange_is_a_gap_and_no_force():
    curves = Curves(10.0, 0.05, 30.0, 1000.0, 10_000)
    curves.add(rows_of(4, force_N=7.0, result=[0, 0, 3, 0]), 0.0)
    assert np.isnan(curves.over_time.since(0)["force_N"]).tolist() == [False, True, False]
    assert curves.loop.since(0)["force_N"].size == 2


def test_durations_are_counted_in_their_class_and_old_ones_go():
    durations = RecentDurations(10)
    durations.add(np.array([5_000] * 10))
    assert durations.counts()[np.searchsorted(EDGES_us, 5.0) - 1] == 10
    durations.add(np.array([2_000_000_000] * 10))
    assert durations.counts()[-1] == 10
    assert durations.counts().sum() == 10
    assert durations.words() == "p50 2000.0 ms, p99 2000.0 ms, max 2000.0 ms"


def test_the_feed_goes_over_to_the_ring_of_a_daemon_that_was_started_again(bench):
    feed = Feed(bench)
    feed.look()
    assert state_words(feed)[0] == "NO TICKS"
    first = ring_of(bench, rows_of(50))
    feed.look()
    assert state_words(feed)[0] == "RUNNING"
    second = ring_of(bench, rows_of(3, state=State.DISARMED, cause=Cause.SAFE))
    feed.look()
    assert state_words(feed)[0] == "DISARMED"
    assert [one.name for one in feed.events] == ["RUNNING", "restarted", "DISARMED"]
    for log in (first, second):
        log.close()


def test_a_fault_is_told_with_reason_remedy_and_reset(bench):
    log = ring_of(bench, rows_of(3, state=State.FAULT, cause=Cause.MAINS_LOST))
    feed = Feed(bench)
    feed.look()
    state, reason, remedy = state_words(feed)
    assert (state, reason) == ("FAULT", "the amplifier reports that its mains are lost")
    assert remedy == "check its supply; then piezod reset"
    log.close()


def test_old_values_are_not_shown_as_new_ones(bench):
    now_s = [100.0]
    log = ring_of(bench, rows_of(3, force_N=12.34))
    feed = Feed(bench, lambda: now_s[0])
    feed.look()
    assert "12.34 N" in lamp_html(feed)
    now_s[0] += 5.0
    feed.look()
    feed.answered(None, "no <socket>")
    assert "12.34 N" not in lamp_html(feed)
    assert "NO TICKS" in lamp_html(feed)
    assert "no &lt;socket&gt;" in lamp_html(feed)
    log.close()


def test_a_device_that_is_not_connected_is_told_in_the_daemons_words(bench):
    feed = Feed(bench)
    feed.answered(
        {"connected": False, "problem": "refused by 10.0.0.7", "ticks": 0, "missed": 0, "failed_exchanges": 0}, ""
    )
    assert state_words(feed) == ("NO TICKS", "refused by 10.0.0.7", "it tries again by itself")


def test_events_are_few_and_the_newest_come_first(bench):
    states = np.tile([State.RUNNING, State.HOLD], 200)
    log = ring_of(bench, rows_of(400, state=states))
    feed = Feed(bench)
    feed.look()
    assert len(feed.events) == MOST_EVENTS
    assert feed.happened == 400
    shown = re.findall("<td>(RUNNING|HOLD)</td>", events_html(feed.events))
    assert shown == ["HOLD", "RUNNING"] * 4
    log.close()


def test_rows_that_were_overwritten_are_told(bench):
    feed = Feed(bench)
    log = ring_of(bench, rows_of(10))
    feed.look()
    for row in rows_of(3000, 10):
        log.append(*row.tolist())
    feed.look()
    assert feed.events[-1].name == "not seen"
    log.close()


def test_the_clock_of_the_curves_is_that_of_the_wall(bench):
    rows = rows_of(200)
    rows["time_ns"] += time.clock_gettime_ns(time.CLOCK_BOOTTIME) - int(rows["time_ns"][-1])
    log = ring_of(bench, rows)
    feed = Feed(bench)
    feed.look()
    shown_s = feed.curves.over_time.since(0)["time_ms"][-1] * 1e-3 - time.localtime().tm_gmtoff
    assert abs(shown_s - time.time()) < 60
    log.close()


@pytest.mark.parametrize(
    ("text", "mode", "says"),
    [("a" * 15, 0o600, "has 15 signs"), ("a" * 32, 0o644, "mode is 0644"), (None, 0o600, "no token can be read")],
)
def test_a_token_that_others_may_know_is_refused(tmp_path, text, mode, says):
    path = tmp_path / "token"
    if text is not None:
        path.write_text(text, encoding="utf-8")
        path.chmod(mode)
    with pytest.raises(ConfigurationError, match=says):
        read_token(path)
