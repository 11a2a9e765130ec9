"""A size that the recordings do not determine is a note with an experiment, and no finding."""

from types import SimpleNamespace

import pytest

from piezod.diagnose.findings import Value
from piezod.diagnose.verdict.low_confidence import undetermined_effect, undetermined_notes
from piezod.diagnose.verdict.words import Wording

SIZES = {
    "noncongruent_minor_loops": ("share", "1"),
    "rate_dependent_hysteresis": ("growth", "1"),
    "creep": ("per_decade", "1"),
    "transport_delay": ("delay_s", "s"),
}


def finding(name, value, low, high, confidence=0.99, status="new"):
    parameter, unit = SIZES[name]
    return SimpleNamespace(
        name=name,
        title=name,
        status=status,
        confidence=confidence,
        before=2.0,
        after=1.0,
        parameters={parameter: Value(value, unit, low, high)},
    )


def of(*effects):
    return SimpleNamespace(effects=effects, unit="N")


@pytest.mark.parametrize(
    ("name", "value", "low", "high"),
    [
        ("noncongruent_minor_loops", 0.4, 0.03, 1.0),  # share 3 to 100 %
        ("creep", 0.02, -0.01, 0.05),  # holds zero
        ("rate_dependent_hysteresis", 0.1, 0.005, 0.47),
        ("creep", 0.3, 0.29, 0.31),  # the most that a creep can be
    ],
)
def test_a_size_between_a_tenth_and_all_is_told_with_its_experiment_however_sure_the_name_is(name, value, low, high):
    found = of(finding(name, value, low, high), finding("transport_delay", 0.01, 0.009, 0.011))
    assert undetermined_effect(found) == [name]
    said = undetermined_notes(found, [name], Wording("V", "N"))
    assert len(said) == 1
    assert "is not determined by these recordings" in said[0]
    assert "; record " in said[0]


def test_a_size_with_a_narrow_interval_stays_however_small_it_is():
    assert (
        undetermined_effect(of(finding("transport_delay", 1e-4, 5e-5, 2e-4), finding("creep", 0.01, 0.004, 0.03))) == []
    )


def test_of_two_undetermined_effects_the_less_confident_is_dropped_first():
    wide = [finding("creep", 0.02, 0.001, 0.1, 0.9), finding("noncongruent_minor_loops", 0.4, 0.03, 1.0, 0.7)]
    assert undetermined_effect(of(*wide)) == ["noncongruent_minor_loops"]


def test_what_the_given_model_has_is_judged_by_its_change_and_not_by_its_size():
    assert undetermined_effect(of(finding("creep", 0.02, 0.001, 0.1, status="changed"))) == []
