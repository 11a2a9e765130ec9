"""The thesis' experiment on the emulated bench, from excitation to the table of six triangles, in one command."""

import json

import pytest

from piezod.excitation import EXCITATIONS
from piezod.model import load_model
from tests.benches.emulator import piezod


@pytest.fixture(scope="module")
def commissioned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("commission")
    done = piezod("commission", "--emulated", "seed_bench", "-o", folder, "--periods", 10, "--json", timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder, json.loads(done.stdout)


@pytest.mark.slow
def test_the_better_models_leave_a_tenth_of_the_hysteresis_that_the_thesis_began_with(commissioned):
    _, result = commissioned
    assert result["better"] == "staircase-minor-loops-multisine"
    openings = {
        name: [one["max_hysteresis_percent"] for one in result["figures"] if one["compensation"] == name]
        for name in ("without", *EXCITATIONS)
    }
    assert all(len(values) == 6 for values in openings.values())
    for name in ("staircase-minor-loops-multisine", "varying-triangles"):
        assert max(openings[name]) <= 0.6
    assert max(openings["constant-triangles"]) < max(openings["without"])
    assert 4.5 < max(openings["without"]) < 6.5


@pytest.mark.slow
def test_models_recordings_and_pages_are_left(commissioned):
    folder, _ = commissioned
    for name in EXCITATIONS:
        assert load_model(folder / f"{name}.yaml").name == name
        assert (folder / f"{name}.csv").stat().st_size > 0
        assert "Identification" in (folder / name / "identification.html").read_text(encoding="utf-8")
    assert (folder / "validation.html").exists()


def test_commission_needs_exactly_one_of_config_and_emulated(tmp_path):
    done = piezod("commission", "-o", tmp_path)
    assert done.returncode == 2
    assert done.stderr.strip() == "piezod: give CONFIG or --emulated SCENARIO, exactly one of them"
