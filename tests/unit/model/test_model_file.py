"""The model file: read, refused, and written with the same text."""

from pathlib import Path

import pytest

from piezod.errors import ConfigurationError, ModelError
from piezod.model import Model, dump_model, load_model, save_model

TEXT = """\
schema: piezod.model/1
name: a stack
input:
  channel: voltage_V
  unit: V
  low: 0.0
  high: 140.0
output:
  channel: force_N
  unit: N
  low: -2.5
  high: 300.0
hysteresis:
  plays:
    thresholds: [0.0, 1.5, 20.0]
    weights: [0.7, 0.1, 3.3e-5]
  dead_zones:
    thresholds: [0.0, 60.0]
    weights: [2.1, -0.30000000000000004]
  offset: 0.125
  eps: 0.01
start:
  kind: reset
  peak: 140.0
provenance:
  created: '2026-11-21T09:00:00+00:00'
  by: a test
  recordings:
  - path: rec.csv
    sha256: 0000000000000000000000000000000000000000000000000000000000000000
    samples: 1000
  fit:
    rms_fit: 0.1
    rms_held_out: 0.11
  notes: ''
"""


@pytest.fixture
def model_file(tmp_path):
    path = tmp_path / "model.yaml"

    def write(old="", new=""):
        assert old in TEXT
        path.write_text(TEXT.replace(old, new, 1) if old else TEXT, encoding="utf-8")
        return path

    return write


def test_a_file_that_is_read_and_written_keeps_its_text(model_file):
    assert dump_model(load_model(model_file())) == TEXT.replace(
        "sha256: 0000000000000000000000000000000000000000000000000000000000000000",
        "sha256: '0000000000000000000000000000000000000000000000000000000000000000'",
    )


def test_the_statistics_of_an_older_file_are_ignored(model_file):
    older = model_file("  notes: ''\n", "  notes: ''\nstatistics:\n  samples: 1000\n  normal: [1.0]\n")
    assert load_model(older) == load_model(model_file())


def test_saving_and_loading_gives_the_same_model_and_the_same_text(model_file, tmp_path):
    model = load_model(model_file())
    save_model(model, tmp_path / "again.yaml")
    again = load_model(tmp_path / "again.yaml")
    assert again == model
    assert (tmp_path / "again.yaml").read_text(encoding="utf-8") == dump_model(again)
    assert [path.name for path in tmp_path.iterdir()] != []
    assert not list(tmp_path.glob(".*"))


def test_the_shipped_model_keeps_its_text():
    path = Path(__file__).parents[3] / "config" / "model.yaml"
    assert dump_model(load_model(path)) == path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("piezod.model/1", "piezod.model/2", ModelError, "schema is 'piezod.model/2', must be 'piezod.model/1'"),
        ("[0.7, 0.1, 3.3e-5]", "[0.7, 0.1]", ModelError, "plays: 3 thresholds and 2 weights"),
        ("[0.7, 0.1, 3.3e-5]", "[0.7, -0.8, 0.9]", ModelError, r"partial sum of weights 0\.\.1 is -0\.1"),
        ("[0.0, 1.5, 20.0]", "[0.0, 20.0, 1.5]", ModelError, "threshold 2 is 1.5, must be above 20"),
        ("[0.0, 60.0]", "[1.0, 60.0]", ModelError, "one threshold being 0"),
        ("0.125", ".nan", ConfigurationError, "hysteresis.offset is nan, must be a finite number"),
        ("peak: 140.0", "peak: null", ConfigurationError, "peak is given with kind reset only"),
        ("high: 140.0", "high: -1.0", ConfigurationError, "low is 0, must be below high, -1"),
        ("offset: 0.125", "ofset: 0.125", ConfigurationError, "unknown key hysteresis.ofset, did you mean 'offset'"),
    ],
)
def test_an_impossible_model_is_refused_in_one_line(model_file, old, new, error, message):
    with pytest.raises(error, match=message) as caught:
        load_model(model_file(old, new))
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 78


def test_states_that_no_input_reaches_are_refused(model_file):
    path = model_file("  kind: reset\n  peak: 140.0", "  kind: states\n  states: [0.0, 9.0, 20.0]")
    with pytest.raises(ModelError, match=r"model\.yaml: play states: state 1 is 9"):
        load_model(path)


def test_a_model_starts_in_the_state_of_its_file(model_file):
    assert load_model(model_file()).operator().states.tolist() == [0.0, 1.5, 20.0]
    assert isinstance(load_model(model_file()), Model)


def test_a_failed_write_is_an_error_and_leaves_no_file(model_file, tmp_path):
    model = load_model(model_file())
    with pytest.raises(ConfigurationError, match="cannot be written"):
        save_model(model, tmp_path / "none" / "model.yaml")


def test_a_file_that_is_no_model_is_not_replaced_by_one(tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text("time_s,voltage_V\n0,0\n", encoding="utf-8")
    (tmp_path / "given.yaml").write_text(TEXT, encoding="utf-8")
    model = load_model(tmp_path / "given.yaml")
    with pytest.raises(ConfigurationError, match="exists and is no model file"):
        save_model(model, path)
    assert path.read_text(encoding="utf-8").startswith("time_s")
    save_model(model, tmp_path / "model.yaml")
    save_model(model, tmp_path / "model.yaml")
