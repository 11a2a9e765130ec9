"""A million samples through the forward operator, against the same loop in C."""

from collections.abc import Callable, Iterator
from time import perf_counter_ns

import numpy as np

from piezod.operators.prandtl_ishlinskii import forward_run
from tests.benchmarks.compiled import compiled
from tests.benchmarks.operators import PEAK_V, SIZES, Array, CChain, make_operator, triangles_V
from tests.benchmarks.rounds import ROUNDS, alternate
from tests.benchmarks.table import NotMeasuredError, Row

SAMPLES = 1_000_000
MOST_RATIO = 2.0

Run = Callable[[Array, Array, Array], None]


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows for slow triangles and for random samples, in both sizes."""
    records = {
        "triangles": triangles_V(SAMPLES),
        "random": np.random.default_rng(1).uniform(0.0, PEAK_V, SAMPLES),
    }
    rounds = ROUNDS if quick else 4 * ROUNDS
    try:
        with compiled("chain.c", "-shared", "-fPIC") as path:
            chain = CChain(path)
            runs: dict[str, Run] = {"numba": forward_run, "C": lambda *arrays: chain.run("forward_run", *arrays)}
            yield from (_row(kind, u, size, runs, rounds) for size in SIZES for kind, u in records.items())
    except NotMeasuredError as reason:
        runs = {"numba": forward_run}
        rows = (_row(kind, u, size, runs, rounds, str(reason)) for size in SIZES for kind, u in records.items())
        yield from rows


def _row(kind: str, u: Array, size: tuple[int, int], runs: dict[str, Run], rounds: int, note: str = "") -> Row:
    outputs = np.empty((len(runs), u.size))
    packed = make_operator(*size).packed

    def measured(run: Run, y: Array) -> Callable[[], float]:
        return lambda: _duration_ms(run, packed.copy(), u, y)

    found = alternate({name: measured(run, y) for (name, run), y in zip(runs.items(), outputs, strict=True)}, rounds)
    largest_difference = np.ptp(outputs, axis=0).max()
    return Row(
        "batch",
        f"10^6 samples, {kind}, {size[0]} plays, {size[1]} dead z.",
        "ms",
        float(found["numba"]),
        float(found["C"]) if "C" in found else None,
        "the same in C, -O2",
        most_ratio=MOST_RATIO,
        note=f"C: not measured: {note}" if note else f"largest difference of the outputs {largest_difference:.1g}",
    )


def _duration_ms(run: Run, packed: Array, u: Array, y: Array) -> float:
    begun = perf_counter_ns()
    run(packed, u, y)
    return (perf_counter_ns() - begun) * 1e-6
