"""The forward chain over recordings of another duration than that of its identification."""

import numpy as np
import pytest

from piezod.model.chain.forward import run_chain
from tests.unit.model.chains import held_model, with_effects


@pytest.mark.parametrize("seconds", [5.0, 20.0])
def test_the_gain_has_changed_by_its_relative_change_at_the_end_of_a_recording_of_any_duration(seconds):
    model = held_model()
    drifting = with_effects(model, "gain_drift", relative_change=0.2, bend=0.0).model_copy(update={"seen_s": 10.0})
    t = np.linspace(0.0, seconds, 501)
    u = np.full(t.size, 60.0)
    stroke_V = model.operator().stroke(u)
    expected = model.operator().output(stroke_V * (1.0 + 0.2 * t / seconds))
    np.testing.assert_allclose(run_chain(drifting, drifting.operator(), t, u), expected, rtol=1e-12)
