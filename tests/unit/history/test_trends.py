"""Slow changes: estimates of single recordings, their test, their line, and the words."""

import itertools
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from piezod.history.checks import find_checks
from piezod.history.parameters import Key
from piezod.history.timeline import timeline_of
from piezod.history.trends import FEWEST, estimates_of, trends_of
from piezod.history.words import trend_words
from piezod.model import load_model, save_model
from piezod.model.parameters import EffectValues
from piezod.report.history import history_text, write_history_page

SHIPPED = Path(__file__).parents[3] / "config" / "model.yaml"
FIRST = datetime(2026, 3, 5, 9, tzinfo=UTC)
CREEP, GAIN = Key("creep", "per_decade"), Key("base", "gain")


def stated(value, unit="1"):
    return {"value": value, "unit": unit, "low": 0.9 * value, "high": 1.1 * value}


def kept(creep, gain=0.9):
    """Findings in which creep and the stack are kept."""
    base = {"status": "kept", "measured": {"gain": stated(gain, "N/V")}}
    effect = {"name": "creep", "parameters": {}, "seen": True, "measured": {"per_decade": stated(creep)}}
    return {"effects": [], "kept": [effect], "base": base}


def changed(creep):
    """Findings in which creep has changed."""
    effect = {"name": "creep", "status": "changed", "parameters": {"per_decade": stated(creep)}}
    return {"effects": [effect], "kept": [], "base": {"status": "kept", "measured": {"gain": stated(0.9, "N/V")}}}


def weekly(all_findings):
    return [(FIRST + timedelta(days=7 * week), findings) for week, findings in enumerate(all_findings)]


def found(all_findings):
    return {trend.key: trend for trend in trends_of(estimates_of(weekly(all_findings)))}


def test_a_creep_that_grows_below_its_scatter_is_a_trend_and_its_line_is_that_of_the_growth():
    rng = np.random.default_rng(1)
    weeks = np.arange(30)
    creeps = 0.010 + 1e-4 * weeks + 5e-4 * rng.normal(size=weeks.size)
    trends = found([kept(creep) for creep in creeps])
    assert set(trends) == {CREEP}
    trend = trends[CREEP]
    least_squares = np.polyfit(weeks, creeps, 1)  # another estimator of the same line
    assert trend.before.value == pytest.approx(least_squares[1], abs=2e-4)
    assert trend.after.value == pytest.approx(np.polyval(least_squares, 29), abs=2e-4)
    assert trend.before.low < 0.010 < trend.before.high
    assert trend.after.low < 0.0129 < trend.after.high
    assert (trend.first, trend.last, trend.count) == (FIRST, FIRST + timedelta(days=203), 30)


def test_unchanged_benches_raise_an_alarm_in_no_more_than_the_stated_share():
    rng = np.random.default_rng(2)
    histories, alarms = 400, 0
    for _ in range(histories):
        alarms += bool(found([kept(*pair) for pair in rng.normal((0.01, 0.9), (1e-3, 0.01), (20, 2))]))
    assert 0 < alarms <= 0.05 * histories + 3.0 * np.sqrt(0.05 * 0.95 * histories)


def test_a_single_wrong_recording_makes_no_trend():
    creeps = [0.01, 0.0102, 0.0099, 0.0101, 0.01, 0.0098, 0.0101, 0.0099, 0.0102, 0.05]
    assert found([kept(creep) for creep in creeps]) == {}


def test_a_stated_change_begins_anew():
    before = [kept(0.010)] * 10
    after = [kept(0.0150 + 1e-5 * k) for k in (1, -1, 2, -2, 0, 1, -1, 2, -2)]
    assert set(found([*before, changed(0.015), *after])) == set()
    assert set(found([*before, *after])) == {CREEP}


def test_too_few_estimates_and_older_files_have_no_trend():
    rising = [kept(0.01 + 1e-4 * k) for k in range(FEWEST)]
    assert set(found(rising)) == {CREEP}
    assert found(rising[:-1]) == {}
    older = {"effects": [], "kept": [{"name": "creep", "parameters": {}, "seen": True}], "base": {"status": "kept"}}
    assert found([older] * 20) == {}


@pytest.mark.parametrize(("count", "wrong_pairs"), [(6, 0), (FEWEST, 3)])
def test_pairs_in_the_wrong_order_that_a_trend_among_five_parameters_may_have(count, wrong_pairs):
    """The exact distribution over all orders, two-sided."""
    orders = np.array(list(itertools.permutations(range(count))))
    falls = sum((orders[:, j] < orders[:, i]).astype(int) for i in range(count) for j in range(i + 1, count))
    p = [2.0 * np.mean(falls <= wrong) for wrong in range(wrong_pairs + 2)]
    assert p[wrong_pairs] < 0.05 / 5 < p[wrong_pairs + 1]


def test_a_trend_is_told_with_values_dates_and_recordings():
    trends = found([kept(0.013 + 8e-4 * week, 0.9 - 0.001 * week) for week in range(11)])
    assert trend_words(trends[CREEP]) == (
        "creep of the stack grew slowly from 1.300 to 2.100 % per decade between 5 March and 14 May (11 recordings)"
    )
    assert trend_words(trends[GAIN]) == (
        "gain of the stack fell slowly from 0.9000 to 0.8900 N/V between 5 March and 14 May (11 recordings)"
    )
    assert json.loads(json.dumps(trends[GAIN].as_dict()))["recordings"] == 11


def test_the_checks_of_a_bench_and_its_page_show_a_trend(tmp_path):
    for week, (date, findings) in enumerate(weekly([kept(0.013 + 8e-4 * week) for week in range(11)])):
        folder = tmp_path / f"stack-{date:%Y%m%dT%H%M%S}"
        folder.mkdir()
        stated = findings | {"verdict": "matches", "words": f"check {week}"}
        (folder / "findings.json").write_text(json.dumps(stated), encoding="utf-8")
    effect = EffectValues(
        name="creep",
        parameters={"per_decade": 0.013, "from_s": 0.1, "to_s": 1000.0, "slope": 0.0, "driven_by": 0.0},
        intervals={"per_decade": (0.0125, 0.0135)},
    )
    save_model(load_model(SHIPPED).model_copy(update={"effects": (effect,)}), tmp_path / "model.yaml")
    timeline = timeline_of([tmp_path / "model.yaml"])
    estimates = estimates_of([check.dated for check in find_checks([tmp_path])])
    trends = trends_of(estimates)
    words = "creep of the stack grew slowly from 1.300 to 2.100 % per decade between 5 March and 14 May (11 recordings)"
    assert f"{words}; all else kept" in history_text(timeline, trends)
    write_history_page(tmp_path / "history.html", timeline, trends=trends, estimates=estimates)
    page = (tmp_path / "history.html").read_text(encoding="utf-8")
    assert f"C{words[1:]}" in page
    assert "Orange line: slow change." in page


def test_a_trend_of_an_effect_that_no_shown_model_has_is_in_words_only(tmp_path):
    save_model(load_model(SHIPPED), tmp_path / "model.yaml")
    timeline, estimates = timeline_of([tmp_path / "model.yaml"]), estimates_of(weekly(map(kept, np.arange(1, 12))))
    write_history_page(tmp_path / "history.html", timeline, trends=trends_of(estimates), estimates=estimates)
    assert "creep of the stack grew slowly".capitalize() in (tmp_path / "history.html").read_text(encoding="utf-8")
