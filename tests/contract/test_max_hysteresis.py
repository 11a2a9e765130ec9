"""The hysteresis that piezod reads off a recording is the one that the emulated bench was made with."""

import pytest

from firmware_sim.physics.bench import Bench
from piezod.identify.scores import max_hysteresis_percent
from tests.unit.firmware_sim.waves import DT_S, opening_percent, triangles


@pytest.mark.parametrize("peaks_V", [[140.0] * 4, [14.0 * k for k in (*range(1, 11), *range(9, 0, -1))]])
def test_two_readings_of_one_loop_agree(peaks_V):
    voltage_V = triangles(peaks_V)
    force_N = Bench("seed_bench", seed=1).run(voltage_V, DT_S)
    if len(set(peaks_V)) == 1:
        voltage_V, force_N = voltage_V[10_000:], force_N[10_000:]  # the steady cycles
    found = max_hysteresis_percent(voltage_V, force_N)
    assert found == pytest.approx(opening_percent(voltage_V, force_N), abs=0.05)
    assert found == pytest.approx(5.5 if len(set(peaks_V)) == 1 else 6.17, abs=0.2)
