"""The JSON schema, the effective configuration, the comments of keys, and the replacement of values."""

from pathlib import Path

import jsonschema
import pytest
import yaml

from piezod.config import BenchConfig, load_bench
from piezod.config.bench import bench_of
from piezod.config.file_text import comments_of, replace_values
from piezod.config.keys import all_values, bench_schema, effective_text, unit_of
from piezod.config.yaml_reader import Document
from piezod.errors import ConfigurationError

CONFIG = Path(__file__).parents[3] / "config"
BENCH = CONFIG / "bench.yaml"
BENCHES = [path for path in sorted(CONFIG.glob("*.yaml")) if "piezod.bench/1" in path.read_text(encoding="utf-8")]
COMMENTS = comments_of(BENCH.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def validator():
    schema = bench_schema(COMMENTS)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def changed(**changes):
    content = yaml.safe_load(BENCH.read_text(encoding="utf-8"))
    for path, value in changes.items():
        *above, key = path.split("__")
        section = content
        for name in above:
            section = section[name]
        section[key] = value
    return content


@pytest.mark.parametrize("path", BENCHES, ids=lambda path: path.stem)
def test_every_shipped_bench_fits_the_schema(validator, path):
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert [error.message for error in validator.iter_errors(content)] == []


@pytest.mark.parametrize(
    "changes",
    [
        {"limits__slew_V_per_s": -3.0},
        {"limits__slew": 3.0},
        {"rate_Hz": "fast"},
        {"link__kind": "modbus_ascii"},
        {"link__registers__force": {"address": 70000}},
        {"arming__without": ["identitiy"]},
        {"schema": "piezod.bench/2"},
    ],
)
def test_the_schema_refuses_the_same_values_as_load_bench(validator, changes):
    content = changed(**changes)
    assert list(validator.iter_errors(content))
    with pytest.raises(ConfigurationError):
        bench_of(Document(BENCH, yaml.safe_dump(content)))


def test_the_schema_describes_keys_by_the_comments_of_the_bench_file():
    limits = bench_schema(COMMENTS)["$defs"]["LimitsConfig"]["properties"]
    assert limits["slew_V_per_s"]["description"] == "[V/s] at most current_max_A / capacitance_F"
    assert [name for name in limits if name != "voltage_max_V" and "description" not in limits[name]] == []


def test_comments_are_read_over_several_lines_and_in_a_section_that_is_commented_out():
    text = (
        "a: 1  # first\nb:\n  c: 'x # y'   # second\n                # goes on\n# r:\n#   s: 0.5   # third\nd: '#no'\n"
    )
    assert comments_of(text) == {"a": "first", "b.c": "second goes on", "r.s": "third"}


@pytest.mark.parametrize("path", BENCHES, ids=lambda path: path.stem)
def test_the_effective_configuration_read_again_is_the_same(path):
    bench = load_bench(path)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    text = effective_text(all_values(bench), content)
    assert bench_of(Document(path, text)) == bench


def test_the_effective_configuration_shows_units_and_defaults():
    content = yaml.safe_load(BENCH.read_text(encoding="utf-8"))
    del content["limits"]["stuck_travel_V"]
    lines = effective_text(all_values(BenchConfig.model_validate(content)), content).splitlines()
    assert "  stuck_travel_V: 5.0                       # V, default" in lines
    assert "  slew_V_per_s: 4000.0                      # V/s" in lines


@pytest.mark.parametrize(
    ("key", "unit"),
    [("slew_V_per_s", "V/s"), ("timeout_s", "s"), ("name", ""), ("low", ""), ("file_MB", "MB"), ("rate_Hz", "Hz")],
)
def test_the_unit_of_a_key_is_the_suffix_of_its_name(key, unit):
    assert unit_of(key) == unit


def test_a_value_is_replaced_and_comments_stay_in_their_column():
    text = "a: 1            # one\nlink:\n  host: 10.0.0.1  # here\n  n: {m: 5}\n"
    made = replace_values(Path("x.yaml"), text, {("link", "host"): "bench.example", ("a",): 20, ("link", "n", "m"): 7})
    assert made == "a: 20           # one\nlink:\n  host: bench.example # here\n  n: {m: 7}\n"


@pytest.mark.parametrize("value", ["true", "12", "a: b", "null", "1e3", "#x"])
def test_a_text_that_yaml_would_read_differently_is_quoted(value):
    made = replace_values(Path("x.yaml"), "a: b\n", {("a",): value})
    assert Document(Path("x.yaml"), made).content == {"a": value}


def test_the_value_of_a_missing_key_cannot_be_replaced():
    with pytest.raises(ConfigurationError, match=r"has no single value link\.host"):
        replace_values(Path("x.yaml"), "link: {port: 5}\n", {("link", "host"): "x"})
