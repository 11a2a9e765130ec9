"""Scores of lives; every expected number was counted without the program."""

import json
import shutil

import numpy as np
import pytest

from firmware_sim.concealed.cli import main
from firmware_sim.concealed.errors import SealError, StudyError
from firmware_sim.concealed.scoring.figures import wilson
from firmware_sim.concealed.scoring.lives.report import figures, lives_as_text
from firmware_sim.concealed.scoring.lives.score import score_life, score_lives
from firmware_sim.concealed.scoring.lives.verdicts import LifeVerdict, parse_step
from firmware_sim.concealed.study.life_truth import TrueLife, holds_lives, read_lives
from firmware_sim.concealed.study.seal import TRUTH

TRUE_N = np.sin(np.arange(400) / 20.0)
CREEP = {"creep": {"per_decade": 0.02}}


def life(change, since, name="case_0001", gain=1.0):
    effect = "creep" if change in {"grows", "gone"} else ""
    return TrueLife(name, "plays", change, effect, "per_decade" if effect else "", CREEP, since, gain, 0.1)


def step(verdict, *reported, given=(), before=0.1, simulated=0.1, effects=1, base=None, cpu_s=1.0, size=1000):
    """Entry of a step; `reported`: (name, status, parameters)."""
    names = [{"name": name, "status": status, "parameters": values} for name, status, values in reported]
    stack = {"status": "kept" if base is None else "changed", "gain": base}
    findings = {"verdict": verdict, "effects": names, "base": stack, "fit": {"held_out": {"before": before}}}
    return parse_step(
        {
            "findings": None if verdict == "failed" else findings,
            "given": list(given),
            "simulated_rms": simulated,
            "effects": effects,
            "model_bytes": size,
            "cpu_s": cpu_s,
        }
    )


def diagnosed(*steps, errors_N=(1.0, 0.0, 0.0, 0.0, 0.0)):
    """Verdict whose models err by a square wave of these heights [N] on the held-out record."""
    wave = np.where(np.arange(TRUE_N.size) % 2, 1.0, -1.0)
    return LifeVerdict(steps, tuple(TRUE_N + error * wave for error in errors_N))


FOUND = step("explained", ("creep", "new", {}))
SAME = step("matches", given=["creep"])
OLD, NEW = {"low": 0.019, "high": 0.021}, {"low": 0.041, "high": 0.043}
GROWN = step("explained", ("creep", "changed", {"per_decade": NEW | {"was": OLD}}), given=["creep"])


def test_a_change_counts_only_with_its_effect_and_its_status():
    grown = life("grows", {"creep": {"per_decade": 0.04}})
    right = score_life(grown, diagnosed(FOUND, SAME, GROWN, SAME), TRUE_N, TRUE_N)
    assert [one.right for one in right.steps] == [True] * 4
    assert right.inside == (True, False)  # 0.02 is in 0.019 to 0.021, 0.04 is not in 0.041 to 0.043
    gone = life("gone", {})
    wrong = score_life(gone, diagnosed(FOUND, SAME, GROWN, SAME), TRUE_N, TRUE_N)
    assert [one.right for one in wrong.steps] == [True, True, False, True]
    assert wrong.inside == ()


def test_an_effect_of_the_given_model_that_is_new_again_is_counted():
    again = step("explained", ("creep", "new", {}), given=["creep"])
    score = score_life(life("none", CREEP), diagnosed(FOUND, again, SAME, SAME), TRUE_N, TRUE_N)
    assert [one.right for one in score.steps] == [True, False, True, True]
    by_name = {figure.name: figure for figure in figures([score])}
    assert by_name["given effects reported as new"].value == 1.0
    unchanged = by_name["unchanged steps: matches, nothing reported"]
    assert (unchanged.value, unchanged.interval) == (pytest.approx(2 / 3), wilson(2, 3))


def test_a_remainder_is_no_failure_of_an_unchanged_step_if_it_was_there_before():
    open_first, still_open = step("partly_explained", ("creep", "new", {})), step("unexplained", given=["creep"])
    before = score_life(life("none", CREEP), diagnosed(open_first, still_open, SAME, still_open), TRUE_N, TRUE_N)
    assert [one.right for one in before.steps] == [True, True, True, False]  # the last: none was flagged before it


def test_a_failed_step_is_wrong():
    score = score_life(life("none", CREEP), diagnosed(FOUND, step("failed"), SAME, SAME), TRUE_N, TRUE_N)
    assert [one.right for one in score.steps] == [True, False, True, True]


def test_a_lower_gain_is_right_with_the_true_gain_in_its_interval():
    lower = life("gain", CREEP, gain=0.95)
    aged = step("explained", base={"low": 0.94, "high": 0.96}, given=["creep"])
    score = score_life(lower, diagnosed(FOUND, SAME, aged, SAME), TRUE_N, TRUE_N)
    assert score.steps[2].right
    assert score.inside == (True,)


def test_models_are_compared_with_the_bench_of_their_time():
    verdict = LifeVerdict((FOUND, SAME, GROWN, SAME), (TRUE_N, TRUE_N, TRUE_N, 2.0 * TRUE_N, 2.0 * TRUE_N))
    score = score_life(life("gone", {}), verdict, TRUE_N, 2.0 * TRUE_N)
    assert score.errors == pytest.approx((1.0,) * 5)  # nothing but the noise of the readings


def test_the_error_after_generations_counts_with_the_noise_of_the_readings():
    # an error of 0.1 N beside a noise of 0.1 N is sqrt 2 noises
    verdict = diagnosed(FOUND, SAME, SAME, SAME, errors_N=(1.0, 0.0, 0.0, 0.0, 0.1))
    score = score_life(life("none", CREEP), verdict, TRUE_N, TRUE_N)
    by_name = {figure.name: figure.value for figure in figures([score])}
    assert by_name["error after five generations, largest"] == pytest.approx(np.sqrt(2.0))
    assert by_name["the same number of effects after five generations"] == 1.0


def test_the_table_names_every_wrong_step():
    score = score_life(life("gone", {}), diagnosed(FOUND, SAME, SAME, SAME), TRUE_N, TRUE_N)
    lines = lives_as_text([score]).splitlines()
    assert lines[-2:] == [
        "1 wrong steps in 1 lives",
        "case_0001 plays, creep, gone creep: step 3: creep:gone -> matches [nothing]",
    ]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    directory = tmp_path_factory.mktemp("lives") / "study"
    assert main(["make", str(directory), "--lives", "1", "--seed", "5", "--family", "plays"]) == 0
    return directory


def test_a_life_is_sealed_before_it_can_be_read(study, tmp_path):
    assert holds_lives(study)
    (one,) = read_lives(study)
    assert (one.family, one.change) == ("plays", "grows")
    description = json.loads((study / "case_0001" / "case.json").read_text())
    assert description["recordings"] == [f"work_{k}.csv" for k in range(1, 5)]
    assert one.effect not in (study / "case_0001" / "case.json").read_text()
    broken = tmp_path / "broken"
    shutil.copytree(study, broken)
    (broken / TRUTH).write_bytes((study / TRUTH).read_bytes() + b" ")
    with pytest.raises(SealError, match="the study is void"):
        read_lives(broken)


def test_a_life_without_a_verdict_is_refused_or_left_out(study, tmp_path):
    with pytest.raises(StudyError, match="has no verdict"):
        score_lives(study, tmp_path)
    assert score_lives(study, tmp_path, partial=True) == []
