"""The study of the emulated bench's effects, in its short form: what is switched on is what the diagnosis names."""

import json
import subprocess
import sys

import pytest

from firmware_sim.physics.effects import Effects
from piezod.effects import EFFECTS
from tests.benches.emulator import ROOT
from tests.studies.strengths import SWITCHED


def studied(*arguments):
    command = [sys.executable, "-m", "tests.studies", "scenarios", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_over_the_link_nothing_is_named_where_nothing_is_wrong_and_an_effect_by_its_name_and_size(tmp_path):
    done = studied("--only", "none,output_nonlinearity,charge_leakage", "--short", "--json", tmp_path / "rows.json")
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    assert [row["named"] for row in rows] == [[], ["output_nonlinearity"], ["charge_leakage"]]
    assert [row["verdict"] for row in rows] == ["matches", "explained", "explained"]
    assert all(abs(row["error_percent"]) < 10.0 for row in rows[1:])
    assert all(row["effect"] in done.stdout for row in rows)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_of_the_catalogue_has_a_scenario_that_the_emulated_bench_can_switch_on(name):
    Effects.model_validate({name: SWITCHED[name].values})
    assert not SWITCHED[name].parameter or EFFECTS[name].parameter(SWITCHED[name].parameter)


def test_an_unknown_scenario_is_refused_by_name():
    done = studied("--only", "none,gremlins")
    assert done.returncode == 2
    assert "no scenario is called gremlins" in done.stderr
