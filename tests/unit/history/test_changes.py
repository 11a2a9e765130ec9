"""A change is a difference beyond both intervals, family-wise over all parameters, or one that a diagnosis states."""

import math

import pytest

from piezod.diagnose.findings import Value
from piezod.history.changes import HALF_95, changes_between, least_significant, z_of
from piezod.history.parameters import Key
from piezod.model.parameters import ModelChange

CREEP = Key("creep", "per_decade")
GAIN = Key("base", "gain")


def value(middle, error=0.0):
    """A value with this standard error."""
    return Value(middle, "1", middle - HALF_95 * error, middle + HALF_95 * error)


def statuses(changes):
    return {change.name: change.status for change in changes}


def test_z_is_the_difference_over_both_standard_errors():
    assert z_of(value(1.0, 0.3), value(2.0, 0.4)) == pytest.approx(1.0 / 0.5)
    assert z_of(value(2.0, 0.3), value(1.0, 0.4)) == pytest.approx(-1.0 / 0.5)


def test_z_takes_the_sides_of_the_intervals_that_face_each_other():
    low = Value(1.0, "s", 0.9, 1.0 + HALF_95 * 0.3)
    high = Value(2.0, "s", 2.0 - HALF_95 * 0.4, 2.1)
    assert z_of(low, high) == pytest.approx(1.0 / 0.5)
    assert z_of(high, low) == pytest.approx(-1.0 / 0.5)


def test_two_values_without_an_interval_have_no_z():
    assert z_of(value(1.0), value(2.0)) is None


@pytest.mark.parametrize(("parameters", "limit"), [(1, 1.959964), (10, 2.807034)])
def test_the_limit_of_z_is_that_of_bonferroni_at_five_percent(parameters, limit):
    assert least_significant(parameters) == pytest.approx(limit, abs=1e-6)


def test_a_difference_within_the_limit_is_kept_and_one_beyond_it_is_a_change():
    limit = least_significant(1)
    for factor, status in ((0.99, "kept"), (1.01, "changed")):
        after = value(1.0 + factor * limit * math.sqrt(2.0) * 0.1, 0.1)
        changes = changes_between({CREEP: value(1.0, 0.1)}, {CREEP: after})
        assert statuses(changes) == {"base": "kept", "creep": status}


def test_an_effect_that_one_model_lacks_is_new_or_gone():
    assert statuses(changes_between({}, {CREEP: value(1.0, 0.1)}))["creep"] == "new"
    assert statuses(changes_between({CREEP: value(1.0, 0.1)}, {}))["creep"] == "gone"


def test_a_value_without_interval_changes_by_any_difference():
    assert statuses(changes_between({GAIN: value(1.0)}, {GAIN: value(1.0)}))["base"] == "kept"
    assert statuses(changes_between({GAIN: value(1.0)}, {GAIN: value(1.001)}))["base"] == "changed"


def test_the_status_that_a_diagnosis_states_overrides_the_comparison():
    before, after = {CREEP: value(1.0, 0.1), GAIN: value(1.0)}, {CREEP: value(1.1, 0.1), GAIN: value(1.1)}
    stated = [
        ModelChange(name="creep", status="changed", words="creep grew"),
        ModelChange(name="base", status="kept", words="as before"),
    ]
    changes = changes_between(before, after, stated)
    assert statuses(changes) == {"base": "kept", "creep": "changed"}
    by_name = {change.name: change for change in changes}
    assert not by_name["base"].parameters[0].changed
    assert by_name["creep"].parameters[0].changed
    assert by_name["creep"].words == "creep grew"


def test_an_effect_that_is_not_seen_is_kept():
    stated = [ModelChange(name="creep", status="not seen", words="")]
    pair = {CREEP: value(1.0, 0.1)}
    assert statuses(changes_between(pair, pair, stated))["creep"] == "kept"
