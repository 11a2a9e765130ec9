"""The next step after each command: it names the user's files, and follows from the result."""

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import typer.main

from piezod import cli
from piezod.diagnose.findings import ABOVE_NOISE, Findings
from piezod.identify.identification import AT_THE_NOISE
from piezod.identify.identification import STRUCTURED as STRUCTURED_IN_IDENTIFY
from piezod.report import next_step
from piezod.report.next_step import of_benches, of_models, of_studies
from piezod.report.page import next_step_html
from tests.unit.report.example_diagnosis import DELAY, STEP, diagnosis

REC, MODEL, FOLDER = Path("my data/work 1.csv"), Path("models/stack.yaml"), Path("out")
BENCH = Path("benches/press.yaml")
GROUP = typer.main.get_command(cli.app)


def findings(verdict="explained", effects=(), **changes) -> Findings:
    return replace(diagnosis(effects=effects, verdict=verdict).findings, **changes)


def after(found, **more):
    return of_models.after_diagnose(found, [REC], MODEL, FOLDER, **more)


ALL = [
    of_models.after_identify([REC], MODEL, useful=True, noises=1.0),
    of_models.after_identify([REC], MODEL, useful=True, noises=None),
    of_models.after_identify([REC], MODEL, useful=True, noises=2.0),
    of_models.after_identify([REC], MODEL, useful=True, noises=1.0, drives_a_bench=False),
    of_models.after_identify([REC], MODEL, useful=True, noises=None, explained=0.65),
    of_models.after_identify([REC], MODEL, useful=False, noises=None),
    of_models.after_identify([REC], MODEL, useful=False, noises=None, drives_a_bench=False),
    of_models.after_identify([REC], MODEL, useful=False, noises=10.0),
    of_models.after_simulate(REC, MODEL, error=1.0, noise=0.1),
    of_models.after_simulate(REC, MODEL, error=None, noise=0.1),
    of_models.after_compare(REC, MODEL, is_model=True, error=1.0, noise=0.1),
    of_models.after_compare(REC, REC, is_model=False, error=1.0, noise=0.1),
    of_models.after_resid(REC, MODEL, white=False, independent=True),
    of_models.after_resid(REC, MODEL, white=False, independent=False),
    after(findings("explained", (DELAY,))),
    after(findings("explained", (DELAY,)), bench=BENCH),
    after(findings("partly_explained", (STEP,)), refused=["load_step"]),
    after(findings("unexplained")),
    after(findings("not_testable")),
    after(findings("matches", not_testable=("creep",))),
    after(findings("explained", (STEP,)), drives_a_bench=False),
    of_models.after_testable([REC], MODEL, None, planned=False, open_pairs=True),
    of_models.after_testable([REC], MODEL, Path("next.csv"), planned=True, open_pairs=True),
    of_models.after_testable([REC], MODEL, Path("next.csv"), planned=False, open_pairs=False),
    of_benches.after_record(REC, BENCH, MODEL, model_exists=True),
    of_benches.after_record(REC, BENCH, MODEL, model_exists=False),
    of_benches.after_convert(REC, has_command=True),
    of_benches.after_convert(REC, has_command=False),
    of_benches.after_report(REC, fault="", drifted=False),
    of_benches.after_report(REC, fault="force above its limit; check", drifted=False),
    of_benches.after_report(REC, fault="", drifted=True, config=BENCH),
    of_benches.after_report(REC, fault="", drifted=False, missed=0.29),
    of_benches.after_check(BENCH, [], model_exists=True),
    of_benches.after_check(BENCH, ["link"], model_exists=True),
    of_benches.after_check(BENCH, [], model_exists=False),
    of_benches.after_proof(BENCH, passed=True),
    of_benches.after_proof(BENCH, passed=False),
    of_benches.after_validate(BENCH, MODEL, better_than_none=True, noises=1.0, complete=True),
    of_benches.after_validate(BENCH, MODEL, better_than_none=True, noises=4.0, complete=True),
    of_benches.after_validate(None, MODEL, better_than_none=True, noises=4.0, complete=True),
    of_benches.after_validate(BENCH, MODEL, better_than_none=False, noises=4.0, complete=True),
    of_benches.after_validate(BENCH, None, better_than_none=False, noises=None, complete=False),
    of_benches.after_investigate(BENCH, MODEL, FOLDER / "model.yaml", extended=True, open_pairs=False),
    of_benches.after_investigate(None, MODEL, FOLDER / "model.yaml", extended=True, open_pairs=True),
    *(
        of_studies.after_history(MODEL, changed=changed, verdict=verdict)
        for changed in (True, False)
        for verdict in (None, "matches", "unexplained")
    ),
    of_studies.after_fleet([FOLDER], FOLDER, recordings=2, unfinished=None, failed=None),
    of_studies.after_fleet([FOLDER], FOLDER, recordings=2, unfinished=("press", MODEL), failed=None),
    of_studies.after_fleet([FOLDER], FOLDER, recordings=2, unfinished=("press", MODEL), failed=REC),
    of_studies.after_fleet([FOLDER], FOLDER, recordings=0, unfinished=None, failed=None),
    of_studies.after_blind_make(FOLDER),
    of_studies.after_blind_run(FOLDER, Path("verdicts"), complete=True),
    of_studies.after_blind_run(FOLDER, Path("verdicts"), complete=False),
    of_studies.after_blind_score(FOLDER),
    of_studies.after_effects(None, "creep"),
    of_studies.after_effects("creep", "creep"),
    of_benches.after_discover(None, None),
    of_benches.after_discover("127.0.0.1", None),
    of_benches.after_discover("127.0.0.1", 5020),
    of_benches.after_init(BENCH),
    of_benches.after_config_check(BENCH, model_exists=True),
    of_benches.after_config_check(BENCH, model_exists=False),
    *(
        of_benches.after_sequence(BENCH, Path("test.yaml"), MODEL, passed=passed, fault=fault)
        for passed, fault in ((None, ""), (True, ""), (False, ""), (False, "force above its limit"))
    ),
    of_benches.after_latency(["rate_Hz: 500"], held=True),
    of_benches.after_demo(passed=True),
    of_benches.after_demo(passed=False),
    of_benches.after_run(BENCH, None, fault="", drifted=True),
    of_benches.after_status({"config": str(BENCH), "connected": False}),
    *(
        of_benches.after_status({"config": str(BENCH), "connected": True, "cause": "x", "state": state, "drift": drift})
        for state in ("FAULT", "DISARMED", "RUNNING")
        for drift in (None, {"drifted": True})
    ),
]


@pytest.mark.parametrize("line", sorted({line for step in ALL for line in step.commands}))
def test_every_command_parses(line):
    program, *arguments = shlex.split(line)
    assert program == "piezod"
    command = GROUP
    while hasattr(command, "commands"):
        command = command.commands[arguments.pop(0)]
    command.make_context(command.name, arguments)  # raises on an unknown option or a missing argument


@pytest.mark.parametrize(
    ("useful", "noises", "explained", "drives_a_bench", "command"),
    [
        (True, None, 0.65, True, "diagnose"),  # tanks: 18 % of the range left
        (True, None, 0.999, True, "record"),
        (False, None, 0.05, False, "diagnose"),  # a circuit with a mode, driven by a multisine
        (False, None, 0.05, True, "record"),
        (False, 10.0, 0.05, True, "diagnose"),
        (False, 2.0, 0.05, True, "record"),
    ],
)
def test_what_a_static_model_leaves_is_diagnosed_at_once(useful, noises, explained, drives_a_bench, command):
    step = of_models.after_identify(
        [REC], MODEL, useful=useful, noises=noises, explained=explained, drives_a_bench=drives_a_bench
    )
    assert step.commands[0].split()[1] == command


def test_a_path_with_a_blank_is_quoted():
    step = of_models.after_identify([REC], MODEL, useful=True, noises=2.0)
    expected = "piezod diagnose 'my data/work 1.csv' --model models/stack.yaml -o models/stack-diagnosis"
    assert step.commands == (expected,)


def test_the_thresholds_are_those_of_the_rooms_that_decide():
    assert next_step.AT_NOISE == ABOVE_NOISE
    assert next_step.RESTING == AT_THE_NOISE
    assert next_step.STRUCTURED == STRUCTURED_IN_IDENTIFY


def test_a_usable_model_at_the_noise_is_driven_and_named_in_the_bench_file():
    step = of_models.after_identify([REC], MODEL, useful=True, noises=1.0)
    assert step.words.startswith("usable")
    assert step.bench_lines == (f"model: {MODEL.resolve()}",)


def test_a_useless_model_is_not_driven():
    step = of_models.after_identify([REC], MODEL, useful=False, noises=None)
    assert step.words.startswith("not usable")
    assert not step.bench_lines
    assert not any(line.startswith("piezod run") for line in step.commands)


def test_an_effect_without_inverse_is_left_out_by_name():
    step = after(findings("explained", (STEP,)), refused=["load_step"])
    assert step.bench_lines == (f"model: {(FOLDER / 'model.yaml').resolve()}", "compensation_without: [load_step]")
    assert "load_step has no inverse and cannot be driven" in step.words


@pytest.mark.parametrize("verdict", ["matches", "unexplained", "not_testable"])
def test_a_verdict_without_a_change_keeps_the_given_model(verdict):
    step = after(findings(verdict))
    assert not step.bench_lines
    assert not any(line.startswith("piezod run") for line in step.commands)


def test_a_running_bench_is_disarmed_before_its_model_changes():
    step = after(findings("explained", (STEP,)), bench=BENCH)
    verbs = [line.split()[1] for line in step.commands]
    assert verbs == ["check", "disarm", "reload", "arm"]


def test_an_open_rival_leads_to_the_planned_drive():
    assert any("--next" in line for line in after(findings("explained", (DELAY,))).commands)
    assert not any("--next" in line for line in after(findings("explained", (STEP,))).commands)


def test_a_drift_leads_to_the_recording_that_the_daemon_kept():
    state = {"config": str(BENCH), "connected": True, "cause": "", "state": "RUNNING", "drift": {"drifted": True}}
    assert of_benches.after_status(state).commands == (f"piezod diagnose --from-bench {BENCH} -o diagnosis",)


def test_a_model_worse_than_none_is_not_driven():
    step = of_benches.after_validate(BENCH, MODEL, better_than_none=False, noises=40.0, complete=True)
    assert "none of these models" in step.words
    assert not step.bench_lines


def test_a_fault_is_reset_only_after_a_check():
    step = of_benches.after_report(
        REC, fault="force above limits.force_trip_N; check specimen", drifted=False, config=BENCH
    )
    assert step.commands == (f"piezod check {BENCH}", f"piezod reset {BENCH}")
    assert "force above limits.force_trip_N" in step.words


def test_text_and_json_hold_the_same_lines():
    step = next_step.NextStep("drive", ("piezod run b.yaml --arm",), ("model: /m.yaml",))
    assert step.text() == "next: drive\n  in the bench file:\n    model: /m.yaml\n    piezod run b.yaml --arm"
    assert step.as_dict() == {
        "words": "drive",
        "commands": ["piezod run b.yaml --arm"],
        "bench_lines": ["model: /m.yaml"],
    }


def test_a_page_shows_the_step_escaped():
    step = next_step.NextStep("diagnose", ("piezod diagnose '<b>.csv'",))
    shown = next_step_html(step)
    assert "piezod diagnose &#x27;&lt;b&gt;.csv&#x27;" in shown
    assert "<b>Next:</b> Diagnose." in shown
    assert next_step_html(None) == ""


@pytest.mark.parametrize(("missed", "verb"), [(0.0, "diagnose"), (0.002, "diagnose"), (0.29, "latency")])
def test_a_run_with_many_missed_ticks_leads_to_the_rate_of_the_machine(missed, verb):
    step = of_benches.after_report(REC, fault="", drifted=False, missed=missed)
    assert step.commands[0].split()[1] == verb
