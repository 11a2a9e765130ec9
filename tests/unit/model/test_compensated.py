"""The effects that the catalogue declares as compensated, against the compensator."""

import numpy as np
import pytest

from piezod.effects import EFFECTS
from piezod.model import ExtendedCompensator
from tests.unit.model.chains import DT_S, held_model, with_effects

COMPENSATED = [name for name, effect in EFFECTS.items() if effect.handling == "compensated"]
NOT_NEUTRAL = {
    "gain_drift": {"relative_change": 0.1},
    "slew_limit": {"limit_V_per_s": 100.0},
    "thermal_drift": {"coefficient_N_per_K": 2.0, "lag_s": 0.0},
}


def planned_V(model):
    """Voltages for a reference known ahead that rises and falls, with a temperature that rises."""
    compensator = ExtendedCompensator(model, DT_S)
    values = 100.0 - 80.0 * np.cos(2.0 * np.pi * np.arange(400) / 100.0)
    voltages = []
    for k, force_N in enumerate(compensator.ahead(values, loop=False)):
        voltages.append(compensator.plan(force_N))
        compensator.commit(150.0 * (k >= 200))
        compensator.update_temperature(20.0 + 0.01 * k)
    return np.array(voltages)


@pytest.mark.parametrize("name", COMPENSATED)
def test_every_compensated_effect_changes_the_planned_voltages(name):
    model = held_model()
    with_it = with_effects(model, name, **NOT_NEUTRAL.get(name, {}))
    assert np.max(np.abs(planned_V(with_it) - planned_V(with_effects(model)))) > 0.1
