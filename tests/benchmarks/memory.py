"""Memory that a million ticks of the compensator leave allocated; the limit is 0."""

import contextlib
import gc
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from itertools import repeat

from piezod.model import Model
from piezod.model.compensator import InverseCompensator
from piezod.model.parameters import Channel, Hysteresis, Provenance, Start, Superposition
from tests.benchmarks.operators import PEAK_V, SIZES, make_operator, triangles_V
from tests.benchmarks.table import Row

TICKS = 1_000_000
PASS = 1000  # ticks over one list of references


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows for both sizes: growth in blocks and in bytes; a step that stores its results shows the sensitivity."""
    passes = (TICKS // 10 if quick else TICKS) // PASS
    for size in SIZES:
        compensator = InverseCompensator(make_model(*size))
        forces_N = make_operator(*size).run(triangles_V(PASS, PASS)).tolist()
        what = f"{size[0]} plays, {size[1]} dead zones, {passes * PASS:.0e} ticks"
        for counter, unit in ((blocks, "block"), (traced_bytes, "byte")):
            with counted(unit):
                grown, storing = (
                    growth(step, forces_N, passes, counter) for step in (tick(compensator), storing_tick(compensator))
                )
            yield Row(
                "memory", what, unit, grown, limit_is="none", most=0, note=f"a step that stores its results: {storing}"
            )


def make_model(plays: int, zones: int) -> Model:
    """The model of `make_operator`."""
    operator = make_operator(plays, zones)
    (play_r, play_w), (zone_r, zone_w) = operator.plays, operator.dead_zones
    return Model(
        schema="piezod.model/1",
        name="benchmark",
        input=Channel(channel="voltage_V", unit="V", low=0.0, high=PEAK_V),
        output=Channel(channel="force_N", unit="N", low=0.0, high=300.0),
        hysteresis=Hysteresis(
            plays=Superposition(thresholds=tuple(play_r.tolist()), weights=tuple(play_w.tolist())),
            dead_zones=Superposition(thresholds=tuple(zone_r.tolist()), weights=tuple(zone_w.tolist())),
        ),
        start=Start(kind="reset", peak=PEAK_V),
        provenance=Provenance(created="1970-01-01T00:00:00Z", by="tests.benchmarks"),
    )


def tick(compensator: InverseCompensator) -> Callable[[float], None]:
    """The calls of the loop to the compensator in one tick."""

    def step(force_N: float) -> None:
        compensator.commit(compensator.plan(force_N))

    return step


def storing_tick(compensator: InverseCompensator) -> Callable[[float], None]:
    """The same, but it stores every voltage in a list."""
    voltages_V: list[float] = []

    def step(force_N: float) -> None:
        voltages_V.append(compensator.plan(force_N))
        compensator.commit(voltages_V[-1])

    return step


def growth(step: Callable[[float], None], forces_N: list[float], passes: int, count: Callable[[], int]) -> int:
    """Growth of `count` over `passes` passes through all `forces_N`, after two passes to warm up."""
    for _ in repeat(None, 2):
        for force_N in forces_N:
            step(force_N)
    before = count()
    before = count()  # again: as at the end, an earlier result exists during the count
    for _ in repeat(None, passes):
        for force_N in forces_N:
            step(force_N)
    return count() - before


def blocks() -> int:
    """Number of allocated blocks of the interpreter."""
    return sys.getallocatedblocks()


def traced_bytes() -> int:
    """Allocated bytes since the start of tracing."""
    return tracemalloc.get_traced_memory()[0]


@contextlib.contextmanager
def counted(unit: str) -> Iterator[None]:
    """The collector frozen and off as in the control process; allocations traced if bytes are counted."""
    gc.collect()
    gc.freeze()
    gc.disable()
    if unit == "byte":
        tracemalloc.start()
    try:
        yield
    finally:
        tracemalloc.stop()
        gc.unfreeze()
        gc.enable()
