"""The record of a proof test."""

import json
import os
import pwd
from datetime import UTC, datetime
from math import inf, nan
from pathlib import Path

import pytest

from piezod.commissioning.proof.coverage import coverage
from piezod.commissioning.proof.record import ProofEnd, ProofStep, make_record, record_path, text_lines
from piezod.config import load_bench
from piezod.errors import ConfigurationError, UsageError
from tests.benches.in_process_link import InProcessLink

BENCH = load_bench(Path(__file__).parents[3] / "config" / "bench.yaml")
NOW = datetime(2026, 11, 25, 4, 5, 6, tzinfo=UTC)
PLANNED = ("level", "force")
PASSED = [ProofStep("level", "pass", 9.5, 1.0, "N"), ProofStep("force", "pass", 5.0, 4.0, "N", 3.0)]


def record(steps=PASSED, left="", interrupted=False):
    link = InProcessLink(None, {"identity": 20570.0})
    return make_record(BENCH, link, ProofEnd(list(steps), left, interrupted), NOW, PLANNED)


def test_a_complete_test_without_a_failure_has_passed():
    made = record()
    assert made["passed"] is True
    assert made["date_utc"] == "2026-11-25T04:05:06Z"
    assert made["identity"] == {"identity": 20570.0}


@pytest.mark.parametrize(("given", "recorded"), [("A. Tester", "A. Tester"), ("", pwd.getpwuid(os.getuid()).pw_name)])
def test_the_record_names_the_tester_and_by_default_the_user(given, recorded):
    link = InProcessLink(None, {"identity": 20570.0})
    made = make_record(BENCH, link, ProofEnd(list(PASSED), "", interrupted=False), NOW, PLANNED, given)
    assert made["tester"] == recorded


@pytest.mark.parametrize(
    "changes",
    [
        {"steps": PASSED[:1]},
        {"steps": PASSED[::-1]},
        {"steps": [PASSED[0], ProofStep("force", "fail")]},
        {"left": "still at 7 V"},
        {"interrupted": True},
        {"steps": []},
    ],
)
def test_a_test_that_is_incomplete_failed_interrupted_or_not_at_rest_has_not_passed(changes):
    assert record(**changes)["passed"] is False


def test_a_function_that_the_bench_lacks_is_skipped_and_fails_nothing():
    assert record([PASSED[0], ProofStep("force", "skipped", detail="none")])["passed"] is True


def test_values_that_were_not_measured_are_null():
    made = record([ProofStep("level", "fail", nan, 1.0, "N", inf)])
    step = json.loads(json.dumps(made, allow_nan=False))["steps"][0]
    assert step["measured"] is step["time_ms"] is None


def test_the_name_holds_bench_and_date_and_an_existing_record_is_refused(tmp_path):
    assert record_path(BENCH, None, NOW).name == "emulator-proof-20261125T040506Z.json"
    with pytest.raises(UsageError, match="never replaced"):
        record_path(BENCH, tmp_path, NOW)


def test_a_folder_that_does_not_exist_is_one_line_before_the_test(tmp_path):
    with pytest.raises(ConfigurationError, match="no folder that this user can write"):
        record_path(BENCH, tmp_path / "none" / "record.json", NOW)


def test_the_text_has_a_line_for_each_step_and_for_a_bad_end():
    lines = list(text_lines(record(left="still at 7 V")))
    assert [line.split()[0] for line in lines[1:4]] == ["PASS", "PASS", "coverage:"]
    assert all(line.startswith("NOT PROVEN") for line in lines[4:-1])
    assert lines[-1].split()[0] == "FAIL"


def test_a_step_that_the_bench_cannot_do_is_printed_as_not_proven_with_its_reason():
    lines = list(text_lines(record([PASSED[0], ProofStep("force", "skipped", detail="no such limit")])))
    assert "NOT PROVEN  force: no such limit" in lines


def test_the_coverage_counts_a_trip_as_proven_only_where_its_step_has_passed():
    found = coverage(BENCH, {"level": "pass", "force": "fail", "minimum": "skipped"})
    assert found["proven"] == 1  # the sign check
    assert found["not_proven"]["force_trip_N"] == "step force: fail"
    assert found["not_proven"]["tracking_trip_N"] == "step tracking: not done"
    assert found["configured"] == 1 + len(found["not_proven"])
    assert found["text"] == f"coverage: 1 of {found['configured']} configured trips proven"


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"force_rate_trip_N_per_s": None}, "force_rate_trip_N_per_s"),
        ({"temperature_trip_degC": None}, "temperature_low_degC"),
        ({"device_watchdog_ms": 0}, "device_watchdog_ms"),
        ({"output_on_in_status": False}, "output_on_in_status"),
    ],
)
def test_a_trip_that_is_off_does_not_count(changes, key):
    bench = BENCH.model_copy(update={"limits": BENCH.limits.model_copy(update=changes)})
    assert key in coverage(BENCH, {})["not_proven"]
    assert key not in coverage(bench, {})["not_proven"]
