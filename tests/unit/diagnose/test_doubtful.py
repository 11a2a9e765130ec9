"""Which names are left out again: the least believed one at a time, and none that carries most of the error."""

from types import SimpleNamespace

import pytest

import piezod
from piezod.diagnose.command import with_checked_law, with_held_out
from piezod.diagnose.findings import Finding, Findings, HeldOut
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.verdict.low_confidence import (
    effects_without_gain,
    highest_confidences,
    is_required,
    least_confident,
)


def doubted(*effects, before=2.0, after=1.0, surest=None):
    """Of effects given as name, confidence, and error without and with it."""
    names = [name for name, *_ in effects]
    found = [SimpleNamespace(name=n, confidence=c, before=b, after=a) for n, c, b, a in effects]
    result = SimpleNamespace(names=names, new=names, given=(), hypothesis=SimpleNamespace(effects=names))
    findings = SimpleNamespace(effects=found, before=before, after=after)
    return effects_without_gain(result, findings, delivered=True) or least_confident(
        result, findings, highest_confidences(findings, surest)
    )


def test_of_two_doubtful_effects_the_less_confident_is_dropped_first():
    effects = ("creep", 0.55, 1.2, 1.0), ("friction", 0.3, 1.1, 1.0), ("resonance", 0.9, 1.5, 1.0)
    assert doubted(*effects) == ["friction"]


def test_none_is_believed_less_for_what_another_took_that_was_left_out():
    effects = ("creep", 0.5, 1.2, 1.0), ("friction", 0.4, 1.1, 1.0)
    assert doubted(*effects, surest={"friction": 0.7}) == ["creep"]
    assert doubted(*effects, surest={"friction": 0.7, "creep": 0.61}) == []


@pytest.mark.parametrize(("confidence", "dropped"), [(0.04, ["creep"]), (0.06, [])])
def test_an_effect_that_what_is_left_contradicts_goes_however_sure_it_was(confidence, dropped):
    assert doubted(("creep", confidence, 9.0, 1.0), surest={"creep": 0.99}) == dropped


def test_a_single_effect_of_low_confidence_is_dropped():
    assert doubted(("creep", 0.55, 1.2, 1.0)) == ["creep"]


@pytest.mark.parametrize("others", [(), (("resonance", 0.9, 1.5, 1.0),)], ids=["alone", "beside a surer one"])
def test_an_effect_that_halves_the_error_is_kept(others):
    assert doubted(("creep", 0.4, 2.1, 1.0), *others) == []
    assert doubted(("creep", 0.4, 1.9, 1.0), *others) == ["creep"]


def test_all_go_where_the_given_model_says_it_as_well():
    assert doubted(("creep", 0.9, 3.0, 1.0), ("friction", 0.9, 2.0, 1.0), before=1.0) == ["creep", "friction"]


@pytest.mark.parametrize("before", [0.9, 1.0, 1.005])
def test_a_confident_effect_without_gain_is_dropped(before):
    assert doubted(("gain_drift", 0.95, before, 1.0), ("creep", 0.9, 2.0, 1.0)) == ["gain_drift"]


@pytest.mark.parametrize(
    ("with_effect", "without_effect", "stays"),
    [
        ("explained", "partly_explained", True),
        ("explained", "unexplained", True),
        ("explained", "explained", False),
        ("explained", "matches", False),
        ("partly_explained", "unexplained", False),
    ],
)
def test_what_is_doubtful_stays_where_a_recording_is_explained_with_it_alone(with_effect, without_effect, stays):
    assert is_required(SimpleNamespace(verdict=with_effect), SimpleNamespace(verdict=without_effect)) == stays


@pytest.mark.parametrize(
    ("held_out", "verdict", "most", "stays"),
    [
        ((2.0, 1.0), "explained", 0.9, False),
        ((1.2, 1.21), "explained", 0.9, False),
        ((2.0, 2.01), "partly_explained", 0.9, False),
        ((2.0, 2.2), "partly_explained", 0.5, True),
    ],
)
def test_a_recording_held_out_that_gets_worse_lowers_verdict_and_confidence(held_out, verdict, most, stays):
    given, extended = piezod.Model.load("config/model.yaml"), object()
    creep = Finding("creep", "creep of the stack", 0.9, "since", (), {}, 2.0, 1.0)
    findings = Findings("explained", "creep", "N", 1.0, "quiet", (), (creep,), 2.0, 1.0, 90.0, 99.0, 0.0)
    found = with_held_out(Diagnosis(findings, extended, [], [], []), given, [HeldOut("later.csv", "", *held_out)])
    assert found.findings.verdict == verdict
    assert found.findings.effects[0].confidence == most
    assert (found.model is given) == stays
    assert ("gets worse" in found.findings.words) == stays
    assert any("later.csv" in note for note in found.findings.notes) == (verdict != "explained")


@pytest.mark.parametrize(("after", "stays"), [((1.0, 0.9), True), ((0.1, 1.01), False)])
def test_an_unnamed_law_goes_where_it_makes_one_recording_held_out_worse(after, stays):
    findings = Findings("unexplained", "", "N", 1.0, "quiet", (), (), 2.0, 1.0, 90.0, 99.0, 0.5)
    plain = Diagnosis(findings, object(), [], [], [])
    with_law = Diagnosis(findings, object(), [], [], [], without_law=plain)
    errors, others = (tuple(HeldOut("later.csv", "", 2.0, one) for one in some) for some in (after, (1.0, 1.0)))
    found, told = with_checked_law(with_law, errors, others)
    assert (found is with_law) == stays
    assert told == (errors if stays else others)
    assert any("left out" in note for note in found.findings.notes) != stays


@pytest.mark.parametrize(("confidence", "left_out"), [(0.0, ["creep"]), (0.19, ["creep"]), (0.21, []), (0.59, [])])
def test_what_is_wrong_four_times_of_five_is_not_named_however_much_it_explains(confidence, left_out):
    assert doubted(("creep", confidence, 10.0, 1.0), before=10.0) == left_out
