"""The date of the last proof test: found among the records, told in status and metrics, overdue after its interval."""

import json
import os
from datetime import UTC, datetime, timedelta

import pytest
from prometheus_client import CollectorRegistry, generate_latest

from piezod.config.sections import ProofConfig
from piezod.daemon.metrics import BenchMetrics
from piezod.daemon.proof_date import ProofDate, last_proof, proof_text
from piezod.daemon.statistics import TickStatistics

NOW = datetime(2026, 11, 27, 12, 0, tzinfo=UTC)


class Bench:
    """What of a bench is looked at."""

    name = "stack-1"
    proof = ProofConfig(interval_days=100.0)


def write(folder, name, **changes):
    record = {"bench": "stack-1", "passed": True, "date_utc": "2026-09-01T12:00:00Z", **changes}
    (folder / f"stack-1-proof-{name}.json").write_text(json.dumps(record), encoding="utf-8")


def aged(days):
    return ProofDate(100.0, NOW - timedelta(days=days), lambda: NOW)


def test_the_newest_record_that_was_passed_counts_whatever_else_lies_there(tmp_path):
    write(tmp_path, "old", date_utc="2025-01-01T00:00:00Z")
    write(tmp_path, "passed")
    write(tmp_path, "failed", date_utc="2026-11-20T12:00:00Z", passed=False)
    write(tmp_path, "other", date_utc="2026-11-21T12:00:00Z", bench="stack-10")
    write(tmp_path, "dateless", date_utc="yesterday")
    (tmp_path / "stack-1-proof-cut.json").write_text('{"bench": ', encoding="utf-8")
    (tmp_path / "stack-1-proof-list.json").write_text("[]", encoding="utf-8")
    os.mkfifo(tmp_path / "stack-1-proof-pipe.json")
    found = last_proof(Bench(), tmp_path / "bench.yaml")
    assert found.passed_at == datetime(2026, 9, 1, 12, 0, tzinfo=UTC)


def test_records_may_lie_in_a_folder_of_their_own(tmp_path):
    (tmp_path / "records").mkdir()
    write(tmp_path / "records", "passed")
    bench = Bench()
    bench.proof = ProofConfig(folder="records")
    assert last_proof(bench, tmp_path / "bench.yaml").passed_at is not None
    bench.proof = None
    assert last_proof(bench, tmp_path / "bench.yaml") is None


@pytest.mark.parametrize(("days", "overdue"), [(0.0, False), (99.9, False), (100.1, True)])
def test_a_proof_test_is_overdue_after_its_interval(days, overdue):
    assert aged(days).is_overdue == overdue
    assert ("OVERDUE" in proof_text(aged(days).as_dict())) == overdue


def test_a_bench_that_was_never_proven_says_so(tmp_path):
    told = last_proof(Bench(), tmp_path / "bench.yaml").as_dict()
    assert told == {"passed_at_utc": None, "age_s": None, "interval_days": 100.0, "overdue": True}
    assert "no record of one that was passed" in proof_text(told)


@pytest.mark.parametrize(
    ("proof", "line"), [(aged(2.0), 'piezod_proof_age_seconds{bench="stack-1"} 172800.0'), (None, "")]
)
def test_its_age_is_a_metric(proof, line):
    registry = CollectorRegistry()
    registry.register(BenchMetrics("stack-1", TickStatistics(lambda *_: None), proof=proof))
    lines = [one for one in generate_latest(registry).decode().splitlines() if one.startswith("piezod_proof_age")]
    assert lines == ([line] if line else [])
