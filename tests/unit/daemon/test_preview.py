"""Cost of a live reference: its change during the lateness of the readings."""

from pathlib import Path

import numpy as np
import pytest

from piezod.config import load_bench
from piezod.config.reference import StreamReference
from piezod.control import ROW_DTYPE, State
from piezod.daemon.preview import MissingPreview, missing_preview
from piezod.model import load_model
from piezod.model.parameters import EffectValues

CONFIG = Path(__file__).parents[3] / "config"
RATE_HZ = 500.0
LIVE = StreamReference(kind="stream", listen="udp://127.0.0.1:9999")


def rows_of(reference_N, state=State.RUNNING):
    rows = np.zeros(reference_N.size, ROW_DTYPE)
    rows["reference_N"], rows["state"] = reference_N, state
    return rows


@pytest.mark.parametrize("late_s", [0.004, 0.0073])
def test_a_ramp_costs_its_slope_times_the_lateness(late_s):
    missing = MissingPreview(late_s, RATE_HZ)
    ramp = rows_of(30.0 * np.arange(1000) / RATE_HZ)
    for first in range(0, 1000, 13):
        missing.add(ramp[first : first + 13])
    assert missing.cost_N == pytest.approx(30.0 * late_s)


def test_a_jump_between_two_runs_costs_nothing():
    missing = MissingPreview(0.01, RATE_HZ)
    missing.add(rows_of(np.full(100, 10.0)))
    missing.add(rows_of(np.full(100, 0.0), State.DISARMED))
    missing.add(rows_of(np.full(100, 90.0)))
    assert missing.cost_N == 0.0


def test_only_a_live_reference_with_late_readings_has_a_cost():
    model = load_model(CONFIG / "model.yaml")
    late = model.model_copy(update={"effects": (EffectValues(name="transport_delay", parameters={"delay_s": 0.008}),)})
    bench = load_bench(CONFIG / "bench.yaml")
    live = bench.model_copy(update={"reference": LIVE})
    assert missing_preview(bench, late) is None
    assert missing_preview(live, model) is None
    assert missing_preview(live, late).late_s == pytest.approx(0.008)
    assert missing_preview(live.model_copy(update={"compensation_without": ("transport_delay",)}), late) is None
