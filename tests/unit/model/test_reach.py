"""No input within its range drives a model out of the range that was measured."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim.concealed.study.nulls import FAMILIES, draw_null
from piezod.errors import ModelError
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.model import save_model
from piezod.model.reach import MOST_BEYOND, beyond_measured, output_reach
from piezod.recording import read_recording
from piezod.session.assembly import load_drivable_model


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Models of one bench of each family, and of each kind of record, by number."""
    found = []
    for number, family in enumerate(FAMILIES):
        null = draw_null(family, number, np.random.SeedSequence([number]))
        path = tmp_path_factory.mktemp(family) / "identification.csv"
        path.write_text(null.identification, encoding="utf-8")
        found.append(identify([read_recording(path)], Options(), "a test").model)
    return lambda which: found[which]


LEVELS = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40)


@settings(max_examples=200)
@given(which=st.integers(0, len(FAMILIES) - 1), levels=LEVELS)
def test_no_course_after_a_first_rise_leads_out_of_the_reach_nor_a_tenth_beyond_what_was_measured(
    models, which, levels
):
    model = models(which)
    low, high = model.input.low, model.input.high
    outputs = model.operator().run(low + (high - low) * np.array([0.0, 1.0, *levels]))[1:]
    least, largest = output_reach(model)
    rounding = 1e-9 * (largest - least)
    assert least - rounding <= outputs.min() <= outputs.max() <= largest + rounding
    assert beyond_measured(model) <= MOST_BEYOND


def test_a_model_that_leaves_the_measured_range_drives_no_bench(models, tmp_path):
    path, model = tmp_path / "model.yaml", models(0)
    save_model(model, path)
    load_drivable_model(path)
    span = model.output.high - model.output.low
    steep = model.model_copy(
        update={"output": model.output.model_copy(update={"high": model.output.high - 0.2 * span})}
    )
    save_model(steep, path)
    with pytest.raises(ModelError, match="% beyond those measured"):
        load_drivable_model(path)
