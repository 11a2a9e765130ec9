"""A tick's worth of the extended inverse, effects included, beside the static one: read the reference, plan, commit."""

from collections.abc import Callable, Iterator
from functools import partial
from time import perf_counter_ns

import numpy as np

from piezod.control import TableReference
from piezod.effects import EFFECTS
from piezod.effects.creep import spectrum
from piezod.model import ExtendedCompensator, Model
from piezod.model.compensator import Compensator, InverseCompensator
from piezod.model.parameters import Channel, EffectValues, Hysteresis, Provenance, Superposition
from tests.benchmarks.operators import make_operator
from tests.benchmarks.rounds import ROUNDS, alternate
from tests.benchmarks.table import Row

TICKS = 100_000
DT_S = 1e-3
MOST_NS = 5000.0
PLAYS, ZONES = 10, 4
FOUND = {
    "electrical_lag": {"time_constant_s": 0.004},
    "creep": {"per_decade": 0.01, "from_s": 0.1, "to_s": 1000.0},
    "resonance": {"frequency_Hz": 90.0, "damping_ratio": 0.1},
    "transport_delay": {"delay_s": 0.007},
}


def measure(*, quick: bool) -> Iterator[Row]:
    """One row; delay and mode have shaped the reference before its first tick, and cost no time there."""
    count = TICKS // 10 if quick else TICKS
    model = extended_model()
    forces_N = 150.0 - 110.0 * np.cos(2.0 * np.pi * np.arange(count) * DT_S)
    actions: dict[str, Callable[[], float]] = {}
    for name, compensator in (
        ("extended", ExtendedCompensator(model, DT_S)),
        ("static", InverseCompensator(model)),
    ):
        reference = TableReference(forces_N)
        if isinstance(compensator, ExtendedCompensator):
            reference.plan_ahead(compensator.ahead, compensator.preview_ticks)
        actions[name] = partial(_tick_ns, reference, compensator, count)
    found = alternate(actions, ROUNDS + 2)
    creep = FOUND["creep"]
    elements = spectrum(creep["from_s"], creep["to_s"])[0].size
    yield Row(
        "extended",
        f"tick, {PLAYS} plays, {ZONES} dead zones, {len(FOUND)} effects",
        "ns",
        float(found["extended"]),
        float(found["static"]),
        "the static inverse",
        most=MOST_NS,
        note=f"{', '.join(FOUND)}; creep of {elements} elements",
    )


def extended_model() -> Model:
    """The operators of the other rows, with effects."""
    operator = make_operator(PLAYS, ZONES)
    plays, zones = (
        Superposition(thresholds=tuple(r.tolist()), weights=tuple(w.tolist()))
        for r, w in (operator.plays, operator.dead_zones)
    )
    effects = tuple(
        EffectValues(
            name=name,
            parameters={one.name: (one.search.choices or one.search.starts)[0] for one in EFFECTS[name].parameters}
            | values,
        )
        for name, values in FOUND.items()
    )
    return Model(
        name="stack",
        input=Channel(channel="voltage_V", unit="V", low=0.0, high=140.0),
        output=Channel(channel="force_N", unit="N", low=0.0, high=300.0),
        hysteresis=Hysteresis(plays=plays, dead_zones=zones, offset=operator.offset),
        effects=effects,
        provenance=Provenance(created="1970-01-01T00:00:00Z", by="benchmark"),
    )


def _tick_ns(reference: TableReference, compensator: Compensator, count: int) -> float:
    compensator.reset()
    reference.start(0)
    begun = perf_counter_ns()
    for tick in range(count):
        reference.read(tick, 0)
        compensator.commit(compensator.plan(reference.ahead))
    return (perf_counter_ns() - begun) / count
