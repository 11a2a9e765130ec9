"""Comparison of a proof test with the one before."""

import json
from pathlib import Path

import pytest

from piezod.commissioning.proof.comparison import change_text, compare
from piezod.commissioning.proof.record import text_lines
from piezod.config import load_bench
from piezod.daemon.proof_date import SCHEMA, proof_records

BENCH = load_bench(Path(__file__).parents[3] / "config" / "bench.yaml")


def record(date, measured_ms=5.0, result="pass", tester="A. Tester", **fields):
    step = {"name": "force", "result": result, "measured": measured_ms, "limit": 20.0, "unit": "ms"}
    step |= {"time_ms": None, "detail": "force trip"}
    return {
        "schema": SCHEMA,
        "bench": BENCH.name,
        "device": "emulator",
        "version": "1",
        "date_utc": date,
        "tester": tester,
        "passed": result == "pass",
        "steps": [step],
        "coverage": {"text": "1 of 1", "not_proven": {}},
        "remark": "",
    } | fields


def write(folder, name, content):
    (folder / f"{BENCH.name}-proof-{name}.json").write_text(json.dumps(content), encoding="utf-8")


def test_the_records_of_the_bench_are_found_by_date_and_strange_files_are_left_out(tmp_path):
    write(tmp_path, "a", record("2026-11-26T08:00:00Z"))
    write(tmp_path, "b", record("2025-11-26T08:00:00Z"))
    write(tmp_path, "later", record("2026-11-28T08:00:00Z"))
    write(tmp_path, "other", record("2026-11-26T09:00:00Z", bench="another"))
    write(tmp_path, "list", [1])
    write(tmp_path, "text", record("2026-11-26T09:00:00Z", steps=[{"name": "force", "measured": "5", "limit": 1}]))
    write(tmp_path, "date", record("yesterday"))
    write(tmp_path, "schema", record("2026-11-26T10:00:00Z", schema="piezod.findings/2"))
    found = proof_records(tmp_path, BENCH.name)
    dates = [one["date_utc"] for one in found]
    assert dates == ["2025-11-26T08:00:00Z", "2026-11-26T08:00:00Z", "2026-11-28T08:00:00Z"]
    compared = compare(record("2026-11-27T12:00:00Z"), found)
    assert compared["compared_with"]["date_utc"] == "2026-11-26T08:00:00Z"


@pytest.mark.parametrize(
    ("before", "now", "text"),
    [
        ((5.0, "pass"), (9.0, "pass"), "pass, 5 ms, since then +20.0 % of its limit"),
        ((5.0, "pass"), (25.0, "fail"), "pass -> fail, 5 ms, since then +100.0 % of its limit"),
        ((25.0, "fail"), (None, "fail"), "fail, 25 ms"),
    ],
)
def test_the_change_of_a_step_is_its_result_and_the_share_of_its_limit(before, now, text):
    present = record("2026-11-27T12:00:00Z", *now)
    compared = compare(present, [record("2026-11-26T08:00:00Z", *before)])
    assert change_text(compared["changes"]["force"]) == text
    assert compared["compared_with"]["tester"] == "A. Tester"
    lines = list(text_lines(present | compared))
    assert any(line.strip() == f"before: {text}" for line in lines)
    assert any("compared with 2026-11-26T08:00:00Z by A. Tester" in line for line in lines)


def test_the_first_run_of_a_day_is_as_found_and_a_first_record_has_nothing_to_compare():
    present = record("2026-11-27T12:00:00Z")
    assert compare(present, [])["as_found_utc"] == "2026-11-27T12:00:00Z"
    assert compare(present, [])["compared_with"] is None
    earlier = [record(date) for date in ("2026-11-26T08:00:00Z", "2026-11-27T08:00:00Z", "2026-11-27T09:00:00Z")]
    assert compare(present, earlier)["as_found_utc"] == "2026-11-27T08:00:00Z"
