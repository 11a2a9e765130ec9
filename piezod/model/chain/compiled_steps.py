"""Compiles the steps of effects, and calls them by address.

A model uses some effects of the catalogue. Its chain is a table of addresses, so that no module lists the effects, and
a new one needs no change here.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from piezod import effects
from piezod.effects.kernels import first_order_step
from piezod.effects.tick import Step
from piezod.operators.compiled_cache import OPERATORS, forget_outdated_steps

CALLED = (OPERATORS, Path(effects.__file__).parent, Path(__file__).parent)
"""Folders of the sources that a compiled step may use."""

_NUMBERS: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
_SIGNATURE = types.float64(_NUMBERS, _NUMBERS, types.float64)


@functools.cache
def address_of(step: Step | None) -> int:
    """Address of a compiled step; 0 for None."""
    if step is None:
        return 0
    forget_outdated_steps(first_order_step.stats.cache_path, CALLED)
    # A division by zero gives inf or nan, which the loop refuses to write.
    address: int = _compiled(step).address
    return address


@functools.cache
def _compiled(step: Step) -> Any:  # noqa: ANN401  # numba has no type for it; kept alive with its machine code
    return numba.cfunc(_SIGNATURE, cache=True, error_model="numpy")(step)


def _call_step(_typing: Any, _address: Any, _own: Any, _shared: Any, _signal: Any) -> Any:  # noqa: ANN401
    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        number = ir.DoubleType()
        pointer = number.as_pointer()
        step = builder.inttoptr(arguments[0], ir.FunctionType(number, [pointer, pointer, number]).as_pointer())
        own, shared = (builder.inttoptr(argument, pointer) for argument in arguments[1:3])
        return builder.call(step, [own, shared, arguments[3]])

    return types.float64(types.int64, types.int64, types.int64, types.float64), build


call_step: Callable[[int, int, int, float], float] = cast("Any", intrinsic(_call_step))
"""Compiled code only: output of the step at an address, for the addresses of two memories and a signal."""
