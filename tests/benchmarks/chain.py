"""One step of the chain called from Python, against the same chain looped in C: forward, plan, commit."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from time import perf_counter_ns

import numba
import numpy as np

from piezod.operators import ImplicitInverse
from piezod.operators.prandtl_ishlinskii import commit_step, forward_step, plan_step
from tests.benchmarks.compiled import compiled
from tests.benchmarks.operators import SIZES, Array, CChain, make_operator, triangles_V
from tests.benchmarks.plain_python import PlainChain
from tests.benchmarks.rounds import ROUNDS, alternate
from tests.benchmarks.table import NotMeasuredError, Row

STEPS = 100_000
MOST_NS = {(10, 4): 250.0}


@dataclass(frozen=True)
class Step:
    """One compiled step, the same step in C over a record and in plain Python."""

    name: str
    call: Callable[[Array, float], float]
    packed: Array
    plain: Callable[[float], float]
    inputs: Array

    @property
    def c_name(self) -> str:
        """Name of the function in `chain.c`."""
        return f"{self.name}_run"


@numba.njit(cache=True)
def empty_step(packed: Array, x: float) -> float:
    """An empty compiled function, which shows the cost of the call alone."""
    return packed[0] + x


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows of every step in both sizes."""
    count = STEPS // 10 if quick else STEPS
    with contextlib.ExitStack() as stack:
        c_chain, note = None, ""
        try:
            c_chain = CChain(stack.enter_context(compiled("chain.c", "-shared", "-fPIC")))
        except NotMeasuredError as reason:
            note = f"C: not measured: {reason}; "
        for size in SIZES:
            for step in _steps(*size, count):
                yield _row(step, size, c_chain, note)


def _steps(plays: int, zones: int, count: int) -> list[Step]:
    inputs_V = triangles_V(count)
    forces_N = make_operator(plays, zones).run(inputs_V)
    operator = make_operator(plays, zones)
    inverse = ImplicitInverse(operator)
    plain = PlainChain(operator)
    return [
        Step("forward", forward_step, operator.packed, plain.forward, inputs_V),
        Step("plan", plan_step, inverse.packed.copy(), PlainChain(operator).plan, forces_N),
        Step("commit", commit_step, inverse.packed.copy(), plain.commit, inputs_V),
    ]


def _row(step: Step, size: tuple[int, int], c_chain: CChain | None, note: str) -> Row:
    inputs = step.inputs.tolist()
    actions: dict[str, Callable[[], float]] = {
        "numba": partial(_calls_ns, step.call, step.packed, inputs),
        "empty": partial(_calls_ns, empty_step, step.packed, inputs),
        "plain": partial(_plain_ns, step.plain, inputs[: len(inputs) // 5]),
    }
    if c_chain is not None:
        actions["C"] = partial(_c_ns, c_chain, step)
    found = alternate(actions, ROUNDS + 2)
    return Row(
        "chain",
        f"{step.name}, {size[0]} plays, {size[1]} dead zones",
        "ns",
        float(found["numba"]),
        float(found["C"]) if "C" in found else None,
        "the same in a C loop",
        most=MOST_NS.get(size),
        note=f"{note}an empty compiled call {found['empty']:.0f} ns; plain Python floats {found['plain']:.0f} ns",
    )


def _calls_ns(step: Callable[[Array, float], float], packed: Array, inputs: list[float]) -> float:
    begun = perf_counter_ns()
    for x in inputs:
        step(packed, x)
    return (perf_counter_ns() - begun) / len(inputs)


def _plain_ns(step: Callable[[float], float], inputs: list[float]) -> float:
    begun = perf_counter_ns()
    for x in inputs:
        step(x)
    return (perf_counter_ns() - begun) / len(inputs)


def _c_ns(c_chain: CChain, step: Step) -> float:
    outputs = np.empty_like(step.inputs)
    begun = perf_counter_ns()
    c_chain.run(step.c_name, step.packed, step.inputs, outputs)
    return (perf_counter_ns() - begun) / outputs.size
