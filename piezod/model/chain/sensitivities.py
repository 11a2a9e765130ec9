"""Derivatives of the chain: a small change of the signal passes through the effects behind it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Context, Effect
from piezod.model.chain.forward import behind


@dataclass(frozen=True)
class Linearised:
    """Linearised effect.

    Parameters
    ----------
    effect, context, values
        Effect, its context and its parameter values.
    slope
        Slope of a memoryless effect, or factor of a scaling one, at every sample, shape (N,); None: neither.
    """

    effect: Effect
    context: Context
    values: Mapping[str, float]
    slope: Array | None

    @property
    def linear(self) -> bool:
        """Whether the effect is linear with a memory, so that it needs every sample."""
        return self.effect.form == "linear"

    def through(self, change: Array, rows: slice = slice(None)) -> Array:  # a slice is not mutable
        """Change behind the effect; `rows` are the samples of the signal that `change` has."""
        if self.linear:
            return self.effect.forward(change, replace(self.context, stroke_per_V=0.0), self.values)
        return change if self.slope is None else change * self.slope[rows]


def unlike_signal(effect: Effect, values: Mapping[str, float], context: Context) -> Array:
    """Factor of a scaling effect, or term that an additive effect adds, shape (N,); neither depends on the signal."""
    size = context.time_s.size
    return effect.forward(np.ones(size) if effect.form == "scaling" else np.zeros(size), context, values)


def linearised(
    effects: Sequence[tuple[Effect, Mapping[str, float]]], signal: Array, context: Context, step: int = 1
) -> tuple[list[Linearised], Array, Context]:
    """Linearised effects in a row, the signal behind them and the context there.

    Parameters
    ----------
    effects
        Effects with their values, in the order of the chain.
    signal
        Signal in front of them at every `step`-th sample, shape (rows,).
    step
        Samples from one row to the next; above 1 no effect may have a memory.
    """
    result = []
    for effect, values in effects:
        forward, slope = effect.forward, None
        if effect.form == "memoryless":
            little = 1e-5 * (float(np.ptp(signal)) + 1e-12)
            above, below = forward(signal + little, context, values), forward(signal - little, context, values)
            slope = (above - below) / (2.0 * little)
        elif effect.form == "scaling":
            slope = unlike_signal(effect, values, context)[::step]
        result.append(Linearised(effect, context, values, slope))
        if slope is not None and effect.form == "scaling":
            signal = signal * slope
        elif step > 1 and effect.form == "additive":
            signal = signal + unlike_signal(effect, values, context)[::step]
        else:
            signal = forward(signal, context, values)
        context = behind(effect, context)
    return result, signal, context
