"""The live page without a browser: curves, durations and events of the ring log, and the status banner."""

import re
import time
from types import SimpleNamespace

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.control import ROW_DTYPE, Cause, RingLog, State
from piezod.errors import ConfigurationError
from piezod.report.figures.durations import EDGES_us, RecentDurations
from piezod.report.live.curves import Curves, RecentPoints
from piezod.report.live.feed import MOST_EVENTS, Feed
from piezod.report.live.server import read_token
from piezod.report.live.status_banner import banner_html, events_html, state_and_remedy
from piezod.transport import ExchangeResult


def words_of(page, feed):
    """HTML of a part of the page with plain blanks."""
    return page(feed).replace("\N{NO-BREAK SPACE}", " ")


def test_a_number_and_its_unit_stay_on_one_line(bench):
    feed = Feed(bench)
    feed.set_status(status(missed=900, ticks=100_000), "")
    assert "900 of 100.9\N{NO-BREAK SPACE}k, 0.89\N{NO-BREAK SPACE}%" in banner_html(feed).replace(
        "900\N{NO-BREAK SPACE}of", "900 of"
    )


def rows_of(count, first=0, **fields):
    rows = np.zeros(count, ROW_DTYPE)
    rows["tick"] = first + np.arange(count)
    rows["time_ns"] = (first + np.arange(count)) * 1_000_000
    rows["state"] = State.RUNNING
    for name, values in fields.items():
        rows[name] = values
    return rows


@pytest.fixture
def now_ns(monkeypatch):
    """Time of the clock that the age of the values is measured by [ns]; the rows are of the first second."""
    now_ns = [1_000_000_000]
    monkeypatch.setattr("piezod.recording.age.clock", SimpleNamespace(boot_ns=lambda: now_ns[0]))
    return now_ns


@pytest.fixture
def bench(tmp_path, now_ns):
    path = tmp_path / "bench.yaml"
    text = shipped("bench.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("/dev/shm/piezod-{name}.ring", str(tmp_path / "ring")), encoding="utf-8")
    return load_bench(path)


def ring_of(bench, rows):
    log = RingLog(bench.ring_log_path, 1000)
    for row in rows:
        log.append(*row.tolist())
    return log


def test_recent_points_drop_the_oldest_and_return_the_new_points():
    points = RecentPoints(("x",), 5)
    points.add({"x": np.arange(4.0)})
    points.add({"x": np.arange(4.0, 8.0)})
    assert points.since(0)["x"].tolist() == [3, 4, 5, 6, 7]
    assert points.since(6)["x"].tolist() == [6, 7]
    assert points.since(8)["x"].size == 0


@pytest.mark.parametrize("chunks", [[1000], [1] * 1000, [7, 493, 500]])
def test_a_spike_of_one_tick_is_drawn_for_any_partition_of_the_rows(chunks):
    curves = Curves(1000.0, 0.05, 30.0, 20.0, 2400)
    force = np.zeros(1000)
    force[321] = 5.0
    first = 0
    for size in chunks:
        curves.add(rows_of(size, first, force_N=force[first : first + size]), 0.0)
        first += size
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


def test_a_force_answers_the_command_of_the_row_before():
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


def test_durations_are_counted_in_their_class_and_old_durations_are_dropped():
    durations = RecentDurations(10)
    durations.add(np.array([5_000] * 10))
    assert durations.counts()[np.searchsorted(EDGES_us, 5.0) - 1] == 10
    durations.add(np.array([2_000_000_000] * 10))
    assert durations.counts()[-1] == 10
    assert durations.counts().sum() == 10
    assert durations.summary() == "p50 2000.0 ms, p99 2000.0 ms, max 2000.0 ms"


def test_the_feed_opens_the_new_ring_after_a_restart_of_the_daemon(bench):
    feed = Feed(bench)
    feed.update()
    assert state_and_remedy(feed)[0] == "STALE"
    first = ring_of(bench, rows_of(50))
    feed.update()
    assert state_and_remedy(feed)[0] == "RUNNING"
    second = ring_of(bench, rows_of(3, state=State.DISARMED, cause=Cause.SAFE))
    feed.update()
    assert state_and_remedy(feed)[0] == "DISARMED"
    assert [one.name for one in feed.events] == ["RUNNING", "restarted", "DISARMED"]
    for log in (first, second):
        log.close()


def test_a_fault_shows_its_reason_its_remedy_and_reset(bench):
    log = ring_of(bench, rows_of(3, state=State.FAULT, cause=Cause.MAINS_LOST))
    feed = Feed(bench)
    feed.update()
    state, reason, remedy = state_and_remedy(feed)
    assert (state, reason) == ("FAULT", "the amplifier reports a loss of mains")
    assert remedy == "check its supply; then piezod reset"
    log.close()


@pytest.mark.parametrize("device_is_silent", [False, True])
def test_stale_values_are_not_shown(bench, now_ns, device_is_silent):
    log = ring_of(bench, rows_of(3, force_N=12.34))
    feed = Feed(bench)
    feed.update()
    assert "12.34 N" in words_of(banner_html, feed)
    now_ns[0] += 1_100_000_000
    if device_is_silent:  # the control process ticks, and no exchange is good
        for row in rows_of(3, 1000, result=ExchangeResult.TIMEOUT, force_N=np.nan):
            log.append(*row.tolist())
    feed.update()
    feed.set_status(None, "no <socket>")
    assert "12.34 N" not in words_of(banner_html, feed)
    assert "STALE" in words_of(banner_html, feed)
    assert "no &lt;socket&gt;" in words_of(banner_html, feed)
    log.close()


def test_a_device_that_is_not_connected_shows_the_message_of_the_daemon(bench):
    feed = Feed(bench)
    feed.set_status(
        {"connected": False, "problem": "refused by 10.0.0.7", "ticks": 0, "missed": 0, "failed_exchanges": 0}, ""
    )
    assert state_and_remedy(feed) == ("STALE", "refused by 10.0.0.7", "the daemon retries automatically")


@pytest.mark.parametrize(("rms_N", "shown"), [(None, False), (0.126, True)])
def test_the_error_of_a_looped_reference_is_shown_once_it_is_known(bench, rms_N, shown):
    feed = Feed(bench)
    learning = {"state": "learning", "passes": 7, "first_N": 1.41, "rms_N": rms_N}
    daemon = {"version": "1", "up_s": 60.0, "model": None, "connected": True, "problem": ""}
    feed.set_status(daemon | {"ticks": 9, "missed": 0, "failed_exchanges": 0, "learning": learning}, "")
    assert ("error, pass 7" in words_of(banner_html, feed)) == shown
    assert ("1.41 \N{RIGHTWARDS ARROW} 0.13 N" in words_of(banner_html, feed)) == shown


def test_events_are_few_and_the_newest_come_first(bench):
    states = np.tile([State.RUNNING, State.HOLD], 200)
    log = ring_of(bench, rows_of(400, state=states))
    feed = Feed(bench)
    feed.update()
    assert len(feed.events) == MOST_EVENTS
    assert feed.event_count == 400
    shown = re.findall("<td>(RUNNING|HOLD)</td>", events_html(feed.events))
    assert shown == ["HOLD", "RUNNING"] * 4
    log.close()


def test_overwritten_rows_are_an_event(bench):
    feed = Feed(bench)
    log = ring_of(bench, rows_of(10))
    feed.update()
    for row in rows_of(3000, 10):
        log.append(*row.tolist())
    feed.update()
    assert feed.events[-1].name == "not seen"
    log.close()


def test_curves_show_the_local_time_of_day(bench):
    rows = rows_of(200)
    rows["time_ns"] += time.clock_gettime_ns(time.CLOCK_BOOTTIME) - int(rows["time_ns"][-1])
    log = ring_of(bench, rows)
    feed = Feed(bench)
    feed.update()
    shown_s = feed.curves.over_time.since(0)["time_ms"][-1] * 1e-3 - time.localtime().tm_gmtoff
    assert abs(shown_s - time.time()) < 60
    log.close()


@pytest.mark.parametrize(
    ("text", "mode", "says"),
    [("a" * 15, 0o600, "has 15 characters"), ("a" * 32, 0o644, "mode is 0644"), (None, 0o600, "no token can be read")],
)
def test_a_short_or_readable_token_is_refused(tmp_path, text, mode, says):
    path = tmp_path / "token"
    if text is not None:
        path.write_text(text, encoding="utf-8")
        path.chmod(mode)
    with pytest.raises(ConfigurationError, match=says):
        read_token(path)


def status(**more):
    daemon = {"version": "1", "up_s": 60.0, "model": None, "connected": True, "problem": ""}
    return daemon | {"ticks": 99_990, "missed": 0, "failed_exchanges": 0} | more


@pytest.mark.parametrize(
    ("missed", "kind", "words"),
    [
        (0, "value ", "0 of 100.0 k"),
        (9, "value warn", "9 of 100.0 k, 0.009 %"),
        (900, "value bad", "900 of 100.9 k, 0.89 %"),
    ],
)
def test_the_share_of_missed_ticks_has_a_colour(bench, missed, kind, words):
    feed = Feed(bench)
    feed.set_status(status(missed=missed), "")
    assert f"<div class='{kind}'><span>ticks missed</span><b>{words}</b>" in words_of(banner_html, feed)


@pytest.mark.parametrize(
    ("drifted", "outside", "kind", "words"),
    [(True, "", "bad", "DRIFTED"), (False, "", "", "holds"), (False, "another input", "warn", "not compared")],
)
def test_a_bench_that_has_left_its_model_is_red(bench, drifted, outside, kind, words):
    feed = Feed(bench)
    drift = {"drifted": drifted, "rms_N": 0.3, "offset_N": -0.4, "limit_N": 0.2, "outside": outside}
    feed.set_status(status(drift=drift), "")
    assert f"<div class='value {kind}'><span>model</span><b>{words}, 0.50 N rms</b>" in words_of(banner_html, feed)


def test_stale_values_are_marked(bench, now_ns):
    log = ring_of(bench, rows_of(3, force_N=12.34))
    feed = Feed(bench)
    feed.update()
    assert "<div class='value '><span>force</span>" in words_of(banner_html, feed)
    now_ns[0] += 5_000_000_000
    feed.update()
    assert "<div class='value bad'><span>force</span>" in words_of(banner_html, feed)
    log.close()
