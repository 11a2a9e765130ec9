"""The range of a reference: from its own keys or from the force limits, checked when the bench file is read."""

import re

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
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


def test_without_keys_the_force_limits_bound_the_reference(tmp_path):
    found = bench(tmp_path).reference_range
    assert (found.low_N, found.high_N) == (-20.0, 360.0)
    assert found.refusal(360.0) == ""
    assert found.refusal(360.1) == "at most limits.force_trip_N, 360"
    assert found.refusal(-20.1) == "at least limits.force_min_N, -20"
    assert found.refusal(float("nan")) != ""


def test_the_keys_bound_the_reference(tmp_path):
    found = bench(tmp_path, low_N=40.0, high_N=260.0).reference_range
    assert (found.low_N, found.high_N) == (40.0, 260.0)
    assert found.refusal(261.0) == "at most reference.high_N, 260"


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"high_N": 259.9}, "reference.offset_N + amplitude_N is 260, must be at most reference.high_N, 259.9"),
        ({"low_N": 40.1}, "reference.offset_N - amplitude_N is 40, must be at least reference.low_N, 40.1"),
        ({"amplitude_N": 211.0}, "is 361, must be at most limits.force_trip_N, 360"),
        ({"offset_N": "1.0e+300"}, "must be at most limits.force_trip_N, 360"),
        ({"high_N": 361.0}, "reference.high_N is 361, must be at most limits.force_trip_N, 360"),
        ({"low_N": -21.0}, "reference.low_N is -21, must be at least limits.force_min_N, -20"),
        ({"low_N": 300.0, "high_N": 200.0}, "low_N is 300, must be below high_N, 200"),
        ({"high_N": ".inf"}, "must be a finite number"),
    ],
)
def test_a_value_beyond_its_bound_is_refused(tmp_path, keys, says):
    with pytest.raises(ConfigurationError, match=re.escape(says)):
        bench(tmp_path, **keys)
