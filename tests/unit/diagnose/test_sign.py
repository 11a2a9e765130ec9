"""A load cell with the other sign: the sign belongs to the model, whatever the options name."""

import json

import numpy as np
import pytest

import piezod
from piezod.diagnose.command import diagnose_files
from piezod.model import load_model
from tests.benches.plain_stack import NOISE_N, RATE_HZ, read, triangles, work


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two recordings of a bench whose readings fall, and a model of the first."""
    place = tmp_path_factory.mktemp("falling")
    for name, voltage_V, seed in (("first", triangles([100, 40, 80, 60, 100, 30]), 1), ("second", work(3, 20.0), 2)):
        columns = np.column_stack((np.arange(voltage_V.size) / RATE_HZ, voltage_V, -read(voltage_V, seed)))
        np.savetxt(place / f"{name}.csv", columns, "%.6f", ",", header="time_s,voltage_V,force_N", comments="")
    piezod.identify(str(place / "first.csv"), output="force_N").model.save(place / "model.yaml")
    return place


@pytest.mark.parametrize("named", [None, "force_N", "-force_N"])
def test_a_falling_reading_is_compared_with_its_own_sign_whatever_names_it(folder, tmp_path, named):
    assert load_model(folder / "model.yaml").output.channel == "-force_N"
    diagnose_files([folder / "second.csv"], folder / "model.yaml", tmp_path, None, named, lambda *_: None)
    findings = json.loads((tmp_path / "findings.json").read_text(encoding="utf-8"))
    assert findings["verdict"] == "matches"
    assert findings["fit"]["held_out"]["before"] < 1.3 * NOISE_N


def test_where_the_noise_shows_nowhere_nothing_is_called_a_match_and_a_recording_is_asked_for(folder, tmp_path):
    diagnose_files([folder / "first.csv"], folder / "model.yaml", tmp_path, None, None, lambda *_: None)
    findings = json.loads((tmp_path / "findings.json").read_text(encoding="utf-8"))
    assert findings["verdict"] == "not_testable"
    assert findings["noise_floor"]["value"] is None
    assert findings["words"].startswith("No effect is found, and the noise is unknown")
    assert any("the noise is unknown" in note and "holds of half a second" in note for note in findings["notes"])
