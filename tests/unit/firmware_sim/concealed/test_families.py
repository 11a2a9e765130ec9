"""Families of plants: each effect that has several laws acts by the law of its family."""

import numpy as np
import pytest

from firmware_sim.concealed.plant.creep import OTHER_LAWS, curve, slope_per_decade
from firmware_sim.concealed.plant.friction import REACHED, lugre_friction, maxwell_slip
from firmware_sim.concealed.plant.sampling import RAIL
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.families import FAMILIES
from tests.unit.firmware_sim.concealed.benches import (
    RATE_HZ,
    REACH_V,
    drive,
    effect,
    forces,
    hold,
    play_plant,
)

COULOMB_N, PRESLIDING_N = 3.0, 20.0
FRICTIONS = {
    "maxwell": lambda force_N: maxwell_slip(force_N, COULOMB_N, PRESLIDING_N, 5),
    "lugre": lambda force_N: lugre_friction(force_N, COULOMB_N, PRESLIDING_N, 1.0, 50.0, 1e-3),
}


@pytest.mark.parametrize("law", FRICTIONS)
def test_every_friction_reaches_its_share_after_the_presliding_travel_and_its_limit_later(law):
    rise_N = np.linspace(0.0, 20.0 * PRESLIDING_N, 20_001)
    friction_N = FRICTIONS[law](rise_N)
    assert np.interp(PRESLIDING_N, rise_N, friction_N) == pytest.approx(REACHED * COULOMB_N, rel=2e-3)
    assert friction_N[-1] == pytest.approx(COULOMB_N, rel=1e-3)
    back_N = FRICTIONS[law](np.concatenate((rise_N, rise_N[::-1])))
    assert back_N[-1] == pytest.approx(-COULOMB_N, rel=1e-3)


def test_stribeck_friction_falls_from_its_static_limit_with_the_speed():
    slow = lugre_friction(np.linspace(0.0, 400.0, 40_001), COULOMB_N, PRESLIDING_N, 1.3, 50.0, 1e-1)[-1]
    fast = lugre_friction(np.linspace(0.0, 400.0, 401), COULOMB_N, PRESLIDING_N, 1.3, 50.0, 1e-3)[-1]
    assert slow == pytest.approx(1.3 * COULOMB_N, rel=1e-3)
    assert fast == pytest.approx(COULOMB_N, rel=1e-3)


@pytest.mark.parametrize("law", OTHER_LAWS)
def test_other_laws_of_creep_have_the_slope_of_one_a_decade_and_rise_from_0(law):
    response = curve(law, 0.5, 0.1, 100.0)
    assert slope_per_decade(response, 0.1, 100.0) == pytest.approx(1.0)
    assert response(np.array([1e-6]))[0] == pytest.approx(0.0, abs=0.02)
    assert np.all(np.diff(response(np.geomspace(1e-3, 1e3, 50))) > 0.0)


@pytest.mark.parametrize("law", ["linear", "averaged"])
def test_widths_that_follow_the_rate_at_rest_let_the_force_move_when_the_command_stops(law):
    voltage_V = np.concatenate((np.linspace(0.0, REACH_V, 2000), hold(REACH_V, 2.0)))
    details = {"law": law, "window_s": 0.01, "fastest_V_per_s": REACH_V * RATE_HZ / 2000}
    on = effect("rate_dependent_hysteresis", details, growth=0.3, reference_V_per_s=1.0)
    force_N = forces(play_plant(), drive(voltage_V), **on)
    plain_N = forces(play_plant(), drive(voltage_V))
    assert force_N[1999] < plain_N[1999] - 0.1
    assert force_N[-1] == pytest.approx(plain_N[-1], rel=2e-3)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_case_of_a_family_has_its_hysteresis_and_its_laws(name):
    family = FAMILIES[name]
    for number, (effect_name, key, expected) in enumerate(
        [
            ("friction", "in_front", family.in_front),
            ("creep", "law", family.creep),
            ("rate_dependent_hysteresis", "law", family.rate),
            ("sensor_dropout", "manner", family.dropout),
        ]
    ):
        case = draw_case(CaseSpec("single", (effect_name,), (20.0,), "white", name), np.random.SeedSequence(number))
        by_rate = effect_name == "rate_dependent_hysteresis"
        assert case.truth["hysteresis"]["kind"] == (family.with_rate if by_rate else family.hysteresis)
        assert case.effects[effect_name].details[key] == expected
        assert case.truth["family"] == name
        if effect_name == "friction":
            (truth,) = case.truth["effects"]
            assert (truth["parameters"]["force_N"] < 0.0) == family.in_front
        if effect_name == "sensor_dropout":
            reading_N = case.reading_N(case.records[1])
            assert (RAIL * case.plant.law.full_N in reading_N) == (family.dropout == "rail")
