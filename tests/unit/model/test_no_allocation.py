"""A million ticks of the compensator allocate no memory that remains."""

import gc
import sys
import tracemalloc
from itertools import repeat

import numpy as np
import pytest

from piezod.control import TableReference
from piezod.model import ExtendedCompensator, Model
from piezod.model.compensator import InverseCompensator
from piezod.model.parameters import Channel, Hysteresis, Provenance, Start, Superposition
from piezod.model.unnamed_law import NAME, LawStep, UnnamedLaw
from tests.benchmarks.extended import extended_model
from tests.benchmarks.memory import growth, traced_bytes

PASS = 1000  # ticks over one list of references


def make_model(plays, zones):
    def superposition(thresholds, first, rest):
        return Superposition(thresholds=tuple(thresholds.tolist()), weights=(first, *repeat(rest, thresholds.size - 1)))

    return Model(
        name="stack",
        input=Channel(channel="voltage_V", unit="V", low=0.0, high=140.0),
        output=Channel(channel="force_N", unit="N", low=0.0, high=300.0),
        hysteresis=Hysteresis(
            plays=superposition(np.linspace(0.0, 70.0, plays + 1), 1.0, 0.8 / plays),
            dead_zones=superposition(np.linspace(0.0, 140.0, zones + 1), 1.2, 0.6 / zones),
        ),
        start=Start(kind="reset", peak=140.0),
        provenance=Provenance(created="1970-01-01T00:00:00Z", by="test"),
    )


@pytest.fixture(params=[(10, 4), (32, 8)], ids="{0[0]} plays, {0[1]} dead zones".format)
def model(request):
    return make_model(*request.param)


@pytest.fixture
def forces_N(model):
    """Forces up and down over the whole range, as plain floats."""
    ramp_V = np.linspace(0.0, 140.0, PASS // 2)
    return model.operator().run(np.concatenate((ramp_V, ramp_V[::-1]))).tolist()


@pytest.fixture
def _idle_collector():
    """Garbage collector frozen and off, as in the control process."""
    gc.collect()
    gc.freeze()
    gc.disable()
    yield
    gc.unfreeze()
    gc.enable()


@pytest.fixture
def _tracing():
    tracemalloc.start()
    yield
    tracemalloc.stop()


def tick_of(model):
    compensator = InverseCompensator(model)

    def tick(force_N):
        compensator.commit(compensator.plan(force_N))

    return tick


@pytest.mark.usefixtures("_idle_collector")
def test_a_million_ticks_of_the_compensator_hold_no_more_blocks_than_before(model, forces_N):
    collections = [generation["collections"] for generation in gc.get_stats()]
    assert growth(tick_of(model), forces_N, 1_000_000 // PASS, sys.getallocatedblocks) == 0
    assert [generation["collections"] for generation in gc.get_stats()] == collections


@pytest.mark.usefixtures("_idle_collector", "_tracing")
def test_a_million_ticks_of_the_compensator_hold_no_more_bytes_than_before(model, forces_N):
    assert growth(tick_of(model), forces_N, 1_000_000 // PASS, traced_bytes) == 0


@pytest.mark.usefixtures("_idle_collector", "_tracing")
@pytest.mark.parametrize("count", [sys.getallocatedblocks, traced_bytes])
def test_a_million_ticks_with_creep_lag_delay_and_resonance_allocate_no_memory_that_remains(count):
    model = extended_model()
    compensator, reference = ExtendedCompensator(model, 1e-3), TableReference(np.linspace(0.0, 200.0, PASS), loop=True)
    reference.plan_ahead(compensator.ahead, compensator.preview_ticks)
    reference.start(0)

    def tick(number):
        reference.read(number, 0)
        compensator.commit(compensator.plan(reference.ahead))

    assert growth(tick, range(PASS), 1_000_000 // PASS, count) == 0


@pytest.mark.usefixtures("_idle_collector", "_tracing")
@pytest.mark.parametrize("count", [sys.getallocatedblocks, traced_bytes])
@pytest.mark.parametrize("gain", [False, True])
def test_ticks_with_an_unnamed_law_allocate_no_memory_that_remains(forces_N, gain, count):
    axes = (
        {"driver": "command", "low": 0.0, "high": 140.0, "nodes": 9},
        {"driver": "way", "low": 0.0, "high": 140.0, "nodes": 8},
    )
    tables = (1e-4 * np.random.default_rng(0).normal(size=(3, 72))).tolist()
    law = {"drivers": axes, "dead_band": 1.0, "smoothing_s": 0.003, "memories_s": (0.0, 0.1, 1.0), "tables": tables}
    law = UnnamedLaw.model_validate(law | {"gain": gain})
    model = extended_model().model_copy(update={"unnamed_law": law})
    compensator = ExtendedCompensator(model, 1e-3)
    assert compensator.compensates_law

    def tick(force_N):
        compensator.commit(compensator.plan(force_N))

    assert growth(tick, forces_N, 200_000 // PASS, count) == 0


def law_with_modes():
    """Complex modes behind tables of the command, beside a lag and a table without one."""
    tables = 1e-2 * np.random.default_rng(1).normal(size=(6, 9))
    modes = [
        {"frequency_Hz": frequency_Hz, "damping_ratio": 0.05, "real": real, "imaginary": imaginary}
        for frequency_Hz, real, imaginary in zip((20.0, 90.0), tables[2:4].tolist(), tables[4:].tolist(), strict=True)
    ]
    axis = {"driver": "command", "low": 0.0, "high": 140.0, "nodes": 9}
    return UnnamedLaw.model_validate(
        {"drivers": (axis,), "dead_band": 1.0, "smoothing_s": 0.003, "memories_s": (0.0, 0.1),
         "tables": tables[:2].tolist(), "modes": modes}
    )  # fmt: skip


@pytest.mark.usefixtures("_idle_collector", "_tracing")
@pytest.mark.parametrize("count", [sys.getallocatedblocks, traced_bytes])
def test_steps_of_a_law_with_complex_modes_allocate_no_memory_that_remains(forces_N, count):
    law = LawStep(law_with_modes(), 1e-3)

    def step(force_N):
        law.step(0.5 * force_N, force_N)

    assert growth(step, forces_N, 200_000 // PASS, count) == 0
    assert law.step(70.0, 140.0) != law.step(0.0, 0.0)


@pytest.mark.usefixtures("_idle_collector", "_tracing")
@pytest.mark.parametrize("count", [sys.getallocatedblocks, traced_bytes])
def test_ticks_beside_a_law_with_modes_that_is_left_out_allocate_no_memory_that_remains(forces_N, count):
    model = extended_model().model_copy(update={"unnamed_law": law_with_modes()})
    compensator = ExtendedCompensator(model, 1e-3, without=(NAME,))
    assert not compensator.compensates_law

    def tick(force_N):
        compensator.commit(compensator.plan(force_N))

    assert growth(tick, forces_N, 200_000 // PASS, count) == 0


@pytest.mark.usefixtures("_idle_collector", "_tracing")
@pytest.mark.parametrize("count", [sys.getallocatedblocks, traced_bytes])
def test_a_step_that_appends_to_a_list_is_caught(forces_N, count):
    forces = []

    def step(force_N):
        forces.append(force_N + 1.0)

    assert growth(step, forces_N, 2, count) >= 2 * PASS
