"""The verdict of a test sequence, and its JUnit XML."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import pytest

from piezod.config.sequence import TestSequence
from piezod.recording import Recording
from piezod.report.next_step import NextStep
from piezod.report.tracking.sequence import evaluate_sequence, junit_xml, sequence_text, write_sequence_page
from piezod.session.task import Outcome

FREQUENCY_HZ = 0.5


@dataclass
class Run:
    recording: Recording
    complete: bool = True
    missed: int = 0
    failed_exchanges: int = 0


def sequence(**limits):
    reference = {"kind": "triangle", "amplitude_N": 50.0, "offset_N": 100.0, "frequency_Hz": FREQUENCY_HZ}
    step = {"name": "a <step>", "reference": reference | {"duration_s": 6.0}, "limits": limits}
    return TestSequence.model_validate({"schema": "piezod.sequence/1", "name": "test", "steps": [step]})


def run(error_N=0.0, loop_N=0.0, **more):
    time_s = np.arange(0.0, 6.0, 1e-3)
    phase = FREQUENCY_HZ * time_s
    reference = 100.0 + 50.0 * (1.0 - 4.0 * np.abs(phase % 1.0 - 0.5))
    force = reference + error_N + np.where(phase % 1.0 < 0.5, -0.5, 0.5) * loop_N
    return Run(Recording(time_s, {"reference_N": reference, "force_N": force, "voltage_V": force}), **more)


def judged(made, outcome=None, **limits):
    return evaluate_sequence(sequence(**limits), [made], outcome or Outcome())


@pytest.mark.parametrize(
    ("limits", "made", "result"),
    [
        ({"rms_error_N": 0.5}, run(error_N=0.4), "passed"),
        ({"rms_error_N": 0.5}, run(error_N=0.6), "FAILED"),
        ({"max_error_N": 0.5}, run(error_N=-0.6), "FAILED"),
        ({"max_hysteresis_percent": 2.0}, run(loop_N=1.0), "passed"),
        ({"max_hysteresis_percent": 0.5}, run(loop_N=1.0), "FAILED"),
        ({"lowest_force_N": 49.0}, run(), "passed"),
        ({"lowest_force_N": 51.0}, run(), "FAILED"),
        ({"highest_force_N": 149.0}, run(), "FAILED"),
        ({"missed_ticks": 0}, run(missed=1), "FAILED"),
        ({"failed_exchanges": 2}, run(failed_exchanges=2), "passed"),
        ({"rms_error_N": 0.5}, run(complete=False), "not run"),
    ],
)
def test_a_step_is_judged_by_its_limit(limits, made, result):
    verdict = judged(made, **limits)
    assert [one.result for one in verdict.results] == [result]
    assert verdict.passed == (result == "passed")


def test_a_loop_that_is_not_closed_fails_and_json_holds_no_nan():
    made = run()
    rising = made.recording.time_s < 0.9
    cut = Recording(made.recording.time_s[rising], {k: v[rising] for k, v in made.recording.channels.items()})
    verdict = judged(Run(cut), max_hysteresis_percent=1.0)
    assert verdict.results[0].result == "FAILED"
    assert verdict.as_dict()["steps"][0]["limits"][0]["value"] is None


def test_a_fault_fails_a_sequence_whose_limits_are_kept():
    verdict = judged(run(), Outcome(fault="force above limits.force_trip_N"), rms_error_N=0.5)
    assert not verdict.passed
    assert verdict.sentence == "test FAILED: FAULT: force above limits.force_trip_N"


def test_junit_counts_failures_and_steps_that_did_not_run():
    failed = ET.fromstring(junit_xml(judged(run(error_N=1.0), rms_error_N=0.5, missed_ticks=0)))
    suite = failed.find("testsuite")
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("3", "1", "0")
    case = suite.find("testcase")
    assert (case.get("classname"), case.get("name")) == ("test.a <step>", "rms_error_N")
    assert case.find("failure").get("message") == "rms_error_N is 1, must be at most 0.5"
    passed = ET.fromstring(junit_xml(judged(run(), rms_error_N=0.5)))
    assert (passed.get("failures"), passed.find(".//failure")) == ("0", None)


@pytest.mark.parametrize(
    ("made", "outcome", "failures"),
    [
        (run(complete=False), Outcome(fault="no link"), 2),
        (run(complete=False), Outcome(stopped=True), 2),
        (run(complete=False), Outcome(), 1),
        (None, Outcome(fault="the run was killed"), 2),
        (run(), Outcome(fault="no link"), 1),
        (run(), Outcome(stopped=True), 1),
    ],
)
def test_a_run_without_its_end_is_a_failure_in_junit_and_never_skipped(made, outcome, failures):
    verdict = evaluate_sequence(sequence(rms_error_N=0.5), [] if made is None else [made], outcome)
    root = ET.fromstring(junit_xml(verdict))
    assert not verdict.passed
    assert [root.get(name) for name in ("tests", "failures", "errors", "skipped")] == ["2", str(failures), "0", "0"]
    assert len(root.findall("testsuite/testcase/failure")) == failures
    assert root.find(".//skipped") is None
    end = root.findall("testsuite/testcase")[-1].find("failure")
    assert (end is None) == (outcome == Outcome())
    assert end is None or end.get("message") in (f"FAULT: {outcome.fault}", "stopped by the user")


def test_the_text_has_a_line_for_each_limit_and_the_verdict():
    lines = sequence_text(judged(run(error_N=0.4), rms_error_N=0.5, missed_ticks=0)).splitlines()
    assert lines[1].split() == ["a", "<step>", "rms_error_N", "0.4", "N", "<=", "0.5", "N", "passed"]
    assert lines[-1] == "test passed: 2 limits of 1 steps are kept"


def test_the_page_holds_verdict_and_curves(tmp_path):
    made = run(error_N=0.4)
    write_sequence_page(tmp_path / "page.html", judged(made, rms_error_N=0.5), [made], NextStep("go on"))
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "test passed: 1 limits of 1 steps are kept" in page
    assert "1. a &lt;step&gt;" in page
    assert "Go on." in page
