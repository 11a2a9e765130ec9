"""The catalogue of effects as table, page and JSON, and the error for an unknown name."""

import json

import pytest

from piezod.effects import EFFECTS
from piezod.errors import UsageError
from piezod.report.effects import effect_named, effect_page, effects_table
from tests.benches.emulator import piezod


def test_the_table_has_a_line_for_every_effect_with_parameters_and_handling():
    lines = effects_table().splitlines()[1:]
    assert len(lines) == len(EFFECTS)
    for line, effect in zip(lines, EFFECTS.values(), strict=True):
        assert line.startswith(effect.name)
        assert effect.handling in line
        assert all(parameter.name in line for parameter in effect.catalogued)


@pytest.mark.parametrize("name", list(EFFECTS))
def test_a_page_holds_the_docstring_and_every_parameter_with_its_unit(name):
    effect = EFFECTS[name]
    page = effect_page(effect)
    assert effect.docstring.strip() in page
    assert effect.separate_by in page
    assert effect.why in page
    for parameter in effect.parameters:
        row = next(line for line in page.splitlines() if line.startswith(f"{parameter.name} "))
        assert f" {parameter.unit} " in row
        assert ("nuisance" in row) == parameter.search.nuisance


@pytest.mark.parametrize(("written", "meant"), [("crep", "creep"), ("hum", "mains_hum"), ("lag", "electrical_lag")])
def test_the_error_for_an_unknown_name_gives_the_most_similar_name(written, meant):
    with pytest.raises(UsageError, match=f"'{written}', the nearest is '{meant}'"):
        effect_named(written)


def test_the_command_prints_json_and_ends_with_2_and_one_line_for_an_unknown_name():
    listed = json.loads(piezod("effects", "--json").stdout)
    assert [one["name"] for one in listed["effects"]] == list(EFFECTS)
    one = json.loads(piezod("effects", "creep", "--json").stdout)
    assert [each["name"] for each in one["effects"]] == ["creep"]
    unknown = piezod("effects", "crep")
    assert unknown.returncode == 2
    assert len(unknown.stderr.splitlines()) == 1
