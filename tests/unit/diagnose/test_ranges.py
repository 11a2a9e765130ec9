"""A recording in another unit than the model is refused at once; one beyond the range of the model is named."""

import numpy as np
import pytest

import piezod
from piezod.diagnose.ranges import compare_ranges
from piezod.errors import RecordingError
from piezod.estimation.recordings.preparation import prepared
from piezod.estimation.recordings.sources import Source
from piezod.model import load_model
from piezod.recording import Recording
from tests.benches.plain_stack import RATE_HZ, read, triangles, work


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """File of a model that was identified up to 100 V."""
    voltage_V = triangles([100, 40, 80, 60, 100, 30])
    place = tmp_path_factory.mktemp("ranges") / "model.yaml"
    piezod.identify(recorded(voltage_V, read(voltage_V, 1))).model.save(place)
    return place


def recorded(voltage_V, force_N):
    time_s = np.arange(voltage_V.size) / RATE_HZ
    return Recording(time_s, {"voltage_V": voltage_V, "force_N": force_N}, source="work.csv")


@pytest.mark.parametrize(
    ("volts", "newtons", "words"),
    [
        (1e-3, 1.0, r"voltage_V reaches 0\.\d+ V, the model was identified up to 100 V; is its unit right"),
        (1e3, 1.0, "voltage_V reaches .* the model was identified up to 100 V; is its unit right"),
        (1.0, 1e-3, "force_N rises by .* N/V, by .* N/V in the model; is its unit right.*force_UNIT"),
        (1.0, 1e3, "force_N rises by .* is its unit right"),
    ],
)
def test_another_unit_is_refused_with_both_numbers(model, volts, newtons, words):
    voltage_V = work(3, 20.0)
    force_N = read(voltage_V, 2)
    with pytest.raises(RecordingError, match=words):
        piezod.diagnose(recorded(volts * voltage_V, newtons * force_N), model)


@pytest.mark.parametrize(("factor", "count"), [(1.0, 0), (0.1, 0), (1.4, 0), (2.0, 1)])
def test_a_command_far_beyond_the_model_is_named_and_a_smaller_one_is_not(model, factor, count):
    voltage_V = factor * triangles([100, 40, 100])
    source = Source(recorded(voltage_V, read(voltage_V, 3)), "0" * 64, "recording")
    notes = compare_ranges(load_model(model), prepared([source], load_model(model)))
    assert len(notes) == count
    assert all("the model is extrapolated" in note for note in notes)


def test_exchanged_columns_are_asked_about(model):
    voltage_V = triangles([100, 40, 100])
    scaled = load_model(model).model_copy(update={"input": load_model(model).input.model_copy(update={"high": 30.0})})
    exchanged = recorded(read(voltage_V, 3), 0.3 * voltage_V)
    notes = compare_ranges(scaled, prepared([Source(exchanged, "0" * 64, "recording")], scaled))
    assert len(notes) == 1
    assert "are the columns exchanged?" in notes[0]


def test_a_reading_that_only_holds_noise_is_not_called_a_wrong_unit(model):
    voltage_V = triangles([100, 40, 100])
    noise_N = np.random.default_rng(1).normal(0.0, 0.02, voltage_V.size)
    source = Source(recorded(voltage_V, noise_N), "0" * 64, "recording")
    assert compare_ranges(load_model(model), prepared([source], load_model(model))) == []
