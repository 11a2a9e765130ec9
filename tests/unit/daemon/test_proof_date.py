"""The date of the last proof test: found among the records, told in status and metrics, overdue after its interval."""

import json
import os
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry, generate_latest

from piezod.config import load_bench
from piezod.config.sections import ProofConfig
from piezod.daemon import proof_date
from piezod.daemon.metrics import BenchMetrics
from piezod.daemon.proof_date import SCHEMA, ProofDate, last_proof, proof_text, proven_sections
from piezod.daemon.statistics import TickStatistics

NOW = datetime(2026, 11, 27, 12, 0, tzinfo=UTC)


STEP = {"name": "force", "result": "pass", "measured": 5.0, "limit": 20.0}


def bench(**changes):
    given = load_bench(Path(__file__).parents[3] / "config" / "bench.yaml")
    return given.model_copy(update={"name": "stack-1", "proof": ProofConfig(interval_days=100.0)} | changes)


def with_limits(**changes):
    return bench(limits=bench().limits.model_copy(update=changes))


def write(folder, name, **changes):
    record = {"schema": SCHEMA, "bench": "stack-1", "passed": True, "date_utc": "2026-09-01T12:00:00Z"}
    record |= {"steps": [STEP], "proven": proven_sections(bench())} | changes
    (folder / f"stack-1-proof-{name}.json").write_text(json.dumps(record), encoding="utf-8")


def found_in(folder, now_is=bench):
    """The last proof test, looked for at NOW."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proof_date.clock, "wall_s", NOW.timestamp)
        return replace(last_proof(bench(), folder / "bench.yaml", now_is), now=lambda: NOW)


def aged(days):
    return ProofDate(100.0, NOW - timedelta(days=days), now=lambda: NOW)


def test_the_newest_record_counts_whatever_else_lies_there(tmp_path):
    write(tmp_path, "old", date_utc="2025-01-01T00:00:00Z")
    write(tmp_path, "passed")
    write(tmp_path, "failed", date_utc="2026-08-20T12:00:00Z", passed=False)
    write(tmp_path, "other", date_utc="2026-11-21T12:00:00Z", bench="stack-10")
    write(tmp_path, "dateless", date_utc="yesterday")
    (tmp_path / "stack-1-proof-cut.json").write_text('{"bench": ', encoding="utf-8")
    (tmp_path / "stack-1-proof-list.json").write_text("[]", encoding="utf-8")
    os.mkfifo(tmp_path / "stack-1-proof-pipe.json")
    found = found_in(tmp_path)
    assert (found.passed_at, found.is_overdue) == (datetime(2026, 9, 1, 12, 0, tzinfo=UTC), False)


@pytest.mark.parametrize(
    "changes",
    [
        {"date_utc": "2099-01-01T00:00:00Z"},
        {"date_utc": "2026-11-27T12:00:01Z"},
        {"date_utc": "2026-9-1T12:00:00Z"},
        {"steps": []},
        {"steps": None},
        {"steps": [STEP, {"name": "rate"}]},
        {"schema": "piezod.findings/2"},
    ],
)
def test_a_record_that_proves_nothing_is_no_proof_and_hides_no_earlier_one(tmp_path, changes):
    write(tmp_path, "strange", **changes)
    assert found_in(tmp_path).passed_at is None
    assert found_in(tmp_path).is_overdue
    write(tmp_path, "passed", date_utc="2026-08-31T12:00:00Z")
    assert found_in(tmp_path).passed_at == datetime(2026, 8, 31, 12, 0, tzinfo=UTC)
    assert not found_in(tmp_path).is_overdue


@pytest.mark.parametrize(
    "changes",
    [
        {"passed": False},
        {"passed": "true"},
        {"steps": [STEP | {"result": "skipped"}]},
        {"steps": [STEP, STEP | {"name": "rate", "result": "fail"}]},
    ],
)
def test_after_one_that_was_not_passed_the_next_one_is_due(tmp_path, changes):
    write(tmp_path, "passed", date_utc="2026-08-31T12:00:00Z")
    write(tmp_path, "later", **changes)
    assert found_in(tmp_path).is_overdue


def test_a_record_without_steps_is_no_proof(tmp_path):
    (tmp_path / "stack-1-proof-x.json").write_text(
        '{"schema": "piezod.proof/1", "bench": "stack-1", "passed": true, "date_utc": "2026-09-01T12:00:00Z"}'
    )
    assert found_in(tmp_path).passed_at is None


@pytest.mark.parametrize(
    ("present", "changed"),
    [
        (lambda: with_limits(force_trip_N=1000.0), ["limits"]),
        (lambda: with_limits(force_trip_N=1.0), ["limits"]),
        (lambda: with_limits(force_rate_trip_N_per_s=None), ["limits"]),
        (lambda: bench(rate_Hz=10.0), ["rate_Hz"]),
        (lambda: bench(arming=bench().arming.model_copy(update={"without": ("sign_check",)})), ["arming"]),
        (lambda: bench(link=bench().link.model_copy(update={"host": "192.0.2.7"})), ["link"]),
        (lambda: bench(load_cell_link=bench().link), ["load_cell_link"]),
        (lambda: bench(model="another.yaml", drift=None), []),
    ],
)
def test_a_change_of_what_was_proven_makes_the_next_one_due_at_once(tmp_path, present, changed):
    write(tmp_path, "passed")
    found = found_in(tmp_path, present)
    assert found.changed == found.as_dict()["changed"] == changed
    assert found.is_overdue == bool(changed)
    assert (found.age_s is None) == bool(changed)
    due = f"proof test: DUE, {', '.join(changed)} changed since 2026-09-01T12:00:00Z" if changed else ""
    assert proof_text(found.as_dict()).startswith(due)
    assert bool(proof_text(found.as_dict())) == bool(changed)


@pytest.mark.parametrize("proven", [None, "all", {}, {"limits": "x"}])
def test_a_record_that_does_not_say_what_it_proves_is_due(tmp_path, proven):
    write(tmp_path, "passed", proven=proven)
    assert found_in(tmp_path).is_overdue
    assert ("limits" in found_in(tmp_path).changed) == isinstance(proven, dict)


def test_a_clock_before_the_last_one_makes_the_next_one_due():
    assert aged(-1.0).is_overdue


def test_records_may_lie_in_a_folder_of_their_own(tmp_path):
    (tmp_path / "records").mkdir()
    write(tmp_path / "records", "passed")
    found = last_proof(bench(proof=ProofConfig(folder="records")), tmp_path / "bench.yaml", bench)
    assert found.passed_at is not None
    assert last_proof(bench(proof=None), tmp_path / "bench.yaml", bench) is None


@pytest.mark.parametrize(("days", "overdue"), [(0.0, False), (99.9, False), (100.1, True)])
def test_a_proof_test_is_overdue_after_its_interval(days, overdue):
    assert aged(days).is_overdue == overdue
    assert ("OVERDUE" in proof_text(aged(days).as_dict())) == overdue


def test_a_bench_that_was_never_proven_says_so(tmp_path):
    told = found_in(tmp_path).as_dict()
    assert told == {"passed_at_utc": None, "age_s": None, "changed": [], "interval_days": 100.0, "overdue": True}
    assert "no record of one that was passed" in proof_text(told)


@pytest.mark.parametrize(
    ("proof", "line"), [(aged(2.0), 'piezod_proof_age_seconds{bench="stack-1"} 172800.0'), (None, "")]
)
def test_its_age_is_a_metric(proof, line):
    registry = CollectorRegistry()
    registry.register(BenchMetrics("stack-1", TickStatistics(lambda *_: None), proof=proof))
    lines = [one for one in generate_latest(registry).decode().splitlines() if one.startswith("piezod_proof_age")]
    assert lines == ([line] if line else [])
