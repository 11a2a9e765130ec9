"""The range of a reference: from its own keys or from the force limits, checked when the bench file is read."""

import re

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.config.reference import FileReference, RegisterReference
from piezod.config.reference_range import reference_range
from piezod.errors import ConfigurationError

TEXT = shipped("bench.yaml").read_text(encoding="utf-8")


def bench(tmp_path, **keys):
    """The bench file with other values of single-line keys of its section `reference`."""
    text = TEXT
    for key, value in keys.items():
        text, count = re.subn(rf"(?m)^(  {key}:) \S+", rf"\1 {value}", text)
        assert count == 1, key
    path = tmp_path / "bench.yaml"
    path.write_text(text, encoding="utf-8")
    return load_bench(path)


LIVE = RegisterReference(kind="register")


def test_without_keys_the_force_limits_bound_a_live_reference_and_a_file(tmp_path):
    limits = bench(tmp_path).limits
    for reference in (LIVE, FileReference(kind="file", path="x.csv")):
        found = reference_range(reference, limits, (-1000.0, 1000.0))
        assert (found.low_N, found.high_N) == (-20.0, 360.0)
        assert found.refusal(360.0) == ""
        assert found.refusal(360.1) == "at most limits.force_trip_N, 360"
        assert found.refusal(-20.1) == "at least limits.force_min_N, -20"
        assert found.refusal(float("nan")) != ""


def test_the_keys_narrow_the_range_and_never_widen_it(tmp_path):
    limits = bench(tmp_path).limits
    found = reference_range(LIVE.model_copy(update={"low_N": 40.0, "high_N": 260.0}), limits, (None, None))
    assert (found.low_N, found.high_N) == (40.0, 260.0)
    assert found.refusal(261.0) == "at most reference.high_N, 260"
    found = reference_range(LIVE.model_copy(update={"low_N": -999.0, "high_N": 999.0}), limits, (None, None))
    assert (found.low_N, found.high_N) == (-20.0, 360.0)


def test_a_force_limit_below_a_waveform_is_no_error_because_a_reload_may_tighten_it(tmp_path):
    text = TEXT.replace("force_trip_N: 360.0", "force_trip_N: 100.0")
    (tmp_path / "tight.yaml").write_text(text, encoding="utf-8")
    assert load_bench(tmp_path / "tight.yaml").limits.force_trip_N == 100.0


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"high_N": 259.9}, "reference.offset_N + amplitude_N is 260, must be at most reference.high_N, 259.9"),
        ({"low_N": 40.1}, "reference.offset_N - amplitude_N is 40, must be at least reference.low_N, 40.1"),
        ({"amplitude_N": 851.0}, "is 1001, must be at most registers.force.high, 1000"),
        ({"offset_N": "1.0e+300"}, "is 1e+300, must be at most registers.force.high, 1000"),
        ({"low_N": 300.0, "high_N": 200.0}, "low_N is 300, must be below high_N, 200"),
        ({"high_N": ".inf"}, "must be a finite number"),
    ],
)
def test_a_value_beyond_its_bound_is_refused(tmp_path, keys, says):
    with pytest.raises(ConfigurationError, match=re.escape(says)):
        bench(tmp_path, **keys)
