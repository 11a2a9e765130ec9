"""The unnamed law: its steps against a plain computation, its drivers, its file, and its compensation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from piezod.model import ExtendedCompensator, load_model, save_model
from piezod.model.chain.forward import run_chain
from piezod.model.law_inverse import LARGEST
from piezod.model.unnamed_law import (
    DIRECTION,
    DRIVERS,
    RATE,
    READING_RATE,
    STROKE,
    WAY,
    Axis,
    LawStep,
    UnnamedLaw,
    driver_tracks,
    node_values,
    positions,
)
from tests.unit.model.chains import DT_S, held_model
from tests.unit.model.test_extended_compensator import driven, reference_N

DEAD, SMOOTH_S = 1.0, 0.003


def law_of(*axes, memories_s=(0.0, 0.05), size=2.0, seed=0):
    nodes = int(np.prod([axis.nodes for axis in axes]))
    tables = size * np.random.default_rng(seed).normal(size=(len(memories_s), nodes))
    return UnnamedLaw(drivers=axes, dead_band=DEAD, smoothing_s=SMOOTH_S, memories_s=memories_s, tables=tables.tolist())


COMMAND_AXIS = Axis(driver="command", low=0.0, high=100.0, nodes=5)
DIRECTION_AXIS = Axis(driver="direction", low=-1.0, high=1.0, nodes=2)
RATE_AXIS = Axis(driver="rate", low=-2000.0, high=2000.0, nodes=5)
WAY_AXIS = Axis(driver="way", low=0.0, high=100.0, nodes=4)


def test_direction_way_and_stroke_refer_to_reversals_that_are_larger_than_the_dead_band():
    command = np.array([0.0, 0.5, 10.0, 50.0, 49.5, 60.0, 40.0, 41.0, 30.0, 45.0])
    tracks = driver_tracks(command, command, DEAD, SMOOTH_S, DT_S)
    np.testing.assert_array_equal(tracks[:, DIRECTION], [0, 0, 1, 1, 1, 1, -1, -1, -1, 1])
    np.testing.assert_array_equal(tracks[:, WAY], [0, 0.5, 10, 50, 49.5, 60, 20, 19, 30, 15])
    np.testing.assert_array_equal(tracks[:, STROKE], [0, 0, 0, 0, 0, 0, 60, 60, 60, 30])


def test_rates_are_those_of_a_ramp_after_their_lag():
    time_s = np.arange(0.0, 0.1, DT_S)
    tracks = driver_tracks(200.0 * time_s, -30.0 * time_s, DEAD, SMOOTH_S, DT_S)
    np.testing.assert_allclose(tracks[-1, [RATE, READING_RATE]], [200.0, -30.0], rtol=1e-9)


@given(st.lists(st.floats(-20.0, 120.0), min_size=1, max_size=60), st.integers(0, 9))
def test_a_law_of_two_drivers_is_a_bilinear_table_behind_first_order_lags(values, seed):
    law, command = law_of(COMMAND_AXIS, DIRECTION_AXIS, seed=seed), np.array(values)
    tracks = driver_tracks(command, command, DEAD, SMOOTH_S, DT_S)
    expected = np.zeros(command.size)
    for memory_s, row in zip(law.memories_s, law.tables, strict=True):
        table = np.array(row).reshape(5, 2)
        clipped = np.clip(command, 0.0, 100.0)
        falling, rising = (np.interp(clipped, np.linspace(0.0, 100.0, 5), table[:, k]) for k in (0, 1))
        here = falling + (tracks[:, DIRECTION] + 1.0) / 2.0 * (rising - falling)
        keep = np.exp(-DT_S / memory_s) if memory_s else 0.0
        state = here[0]
        for k, one in enumerate(here):
            state = keep * state + (1.0 - keep) * one
            expected[k] += state
    np.testing.assert_allclose(LawStep(law, DT_S).run(command, command), expected, atol=1e-9)


def test_steps_and_a_run_agree_and_a_reset_begins_anew():
    law, command = law_of(WAY_AXIS), 50.0 + 50.0 * np.sin(np.arange(200) / 9.0)
    step, expected = LawStep(law, DT_S), LawStep(law, DT_S).run(command, command)
    for _ in range(2):
        for value, added in zip(command, expected, strict=True):
            assert step.step(value, value) == pytest.approx(added, abs=1e-12)
        step.reset()


def test_a_gain_multiplies_what_the_reading_has_moved_from_its_start():
    added = law_of(WAY_AXIS)
    command = 50.0 - 50.0 * np.cos(np.arange(200) / 9.0)
    reading = 7.0 + 2.0 * command
    expected = (reading - 7.0) * LawStep(added, DT_S).run(command, reading)
    gain = LawStep(added.model_copy(update={"gain": True}), DT_S)
    np.testing.assert_allclose(gain.run(command, reading), expected, atol=1e-9)


@pytest.mark.parametrize("driver", DRIVERS)
def test_positions_are_the_inverse_of_the_nodes(driver):
    low = {"command": 3.0, "reading": -7.0, "way": 0.0, "stroke": 0.0, "direction": -1.0}.get(driver, -50.0)
    axis = Axis(driver=driver, low=low, high=1.0 if driver == "direction" else 50.0, nodes=9)
    np.testing.assert_allclose(positions(axis, node_values(axis)), np.linspace(0.0, 1.0, 9), atol=1e-12)
    np.testing.assert_allclose(positions(axis, np.array([-1e9, 1e9])), [0.0, 1.0])


def test_a_model_file_keeps_its_law_and_simulates_it(tmp_path):
    model = held_model()
    with_it = model.model_copy(update={"unnamed_law": law_of(COMMAND_AXIS, DIRECTION_AXIS)})
    save_model(with_it, tmp_path / "model.yaml")
    loaded = load_model(tmp_path / "model.yaml")
    assert loaded.unnamed_law == with_it.unnamed_law
    time_s = np.arange(0.0, 1.0, DT_S)
    command = 50.0 + 50.0 * np.sin(20.0 * time_s)
    plain, extended = (run_chain(one, one.operator(), time_s, command) for one in (model, loaded))
    np.testing.assert_allclose(extended - plain, LawStep(with_it.unnamed_law, DT_S).run(command, plain), atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"tables": [[1.0] * 5]}, "tables has 1 rows, must have one for each of 2"),
        ({"tables": [[1.0] * 5, [1.0] * 4]}, "tables has a row of 4 values, must have 5"),
        ({"memories_s": [0.0, -1.0]}, "memories_s has -1, must be at least 0"),
        ({"drivers": [{"driver": "force", "low": 0.0, "high": 1.0, "nodes": 5}]}, "driver"),
        ({"drivers": [{"driver": "way", "low": 1.0, "high": 1.0, "nodes": 5}]}, "low is 1, must be below high, 1"),
    ],
)
def test_a_law_that_is_wrong_is_refused(changes, says):
    with pytest.raises(ValidationError, match=says):
        UnnamedLaw.model_validate(law_of(COMMAND_AXIS).model_dump() | changes)


@pytest.mark.parametrize(
    ("axes", "left"),
    [
        ((COMMAND_AXIS,), 0.01),
        ((Axis(driver="reading", low=0.0, high=250.0, nodes=5),), 0.01),
        ((COMMAND_AXIS, DIRECTION_AXIS), 0.2),  # it jumps at a reversal, which the dead band shows too late
        ((WAY_AXIS, DIRECTION_AXIS), 0.2),
    ],
)
def test_a_law_is_compensated(axes, left):
    model = held_model()
    t, reference = reference_N(model)
    with_it = model.model_copy(update={"unnamed_law": law_of(*axes, size=1.0)})
    assert ExtendedCompensator(with_it, DT_S).compensates_law
    errors = []
    for compensated in (model, with_it):
        reading = run_chain(with_it, with_it.operator(), t, driven(compensated, reference, low_V=-1e3))
        errors.append(float(np.sqrt(np.mean((reading - reference) ** 2))))
    assert errors[1] < left * errors[0], errors


@pytest.mark.parametrize("axis", [RATE_AXIS, Axis(driver="stroke", low=0.0, high=100.0, nodes=4)])
def test_a_gain_is_compensated(axis):
    model = held_model()
    t, reference = reference_N(model)
    law = law_of(axis, memories_s=(0.05, 0.5), size=0.01).model_copy(update={"gain": True})
    with_it = model.model_copy(update={"unnamed_law": law})
    assert ExtendedCompensator(with_it, DT_S).compensates_law
    errors = []
    for compensated in (model, with_it):
        reading = run_chain(with_it, with_it.operator(), t, driven(compensated, reference, low_V=-1e3))
        errors.append(float(np.sqrt(np.mean((reading - reference) ** 2))))
    assert errors[1] < 0.05 * errors[0], errors


def test_a_reset_forgets_the_planned_voltage():
    model = held_model()
    axis = Axis(driver="reading", low=-50.0, high=250.0, nodes=5)
    with_it = model.model_copy(update={"unnamed_law": law_of(axis, size=1.0)})
    planned = []
    for warm in (False, True):
        compensator = ExtendedCompensator(with_it, DT_S)
        if warm:
            compensator.commit(compensator.plan(0.0))
            compensator.reset()
        compensator.commit(0.0)
        planned.append(compensator.plan(100.0))
    assert planned[0] == planned[1]


def test_a_law_that_changes_more_than_the_force_is_left_out():
    model = held_model()
    steep = law_of(COMMAND_AXIS, memories_s=(0.0,), size=1.0)
    over_command, _ = LawStep(steep, DT_S).steepest()
    tables = [[1e3 * value / over_command for value in row] for row in steep.tables]
    with_it = model.model_copy(update={"unnamed_law": steep.model_copy(update={"tables": tables})})
    assert LawStep(with_it.unnamed_law, DT_S).steepest()[0] > LARGEST
    assert not ExtendedCompensator(with_it, DT_S).compensates_law
    _, reference = reference_N(model)
    np.testing.assert_allclose(driven(with_it, reference), driven(model, reference), atol=1e-9)
