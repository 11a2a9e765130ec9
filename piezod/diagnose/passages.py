"""How a small change of the signal passes through the effects that lie behind it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.effects.effect import Context, Effect
from piezod.model.plant import behind

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Passage:
    """How a small change of the signal passes through an effect.

    Parameters
    ----------
    effect, context, values
        Which effect.
    slope
        Of a memoryless effect at every sample, shape (N,).
    """

    effect: Effect
    context: Context
    values: Mapping[str, float]
    slope: Array | None

    @property
    def linear(self) -> bool:
        """Whether it may remember, and needs the whole signal."""
        return self.effect.form == "linear"

    def through(self, change: Array, kept: slice = slice(None)) -> Array:  # a slice is not mutable
        """The change behind the effect; `kept` are the samples that it has of the signal's."""
        if self.linear:
            return self.effect.forward(change, self.context, self.values)
        return change if self.slope is None else change * self.slope[kept]


def passages(
    effects: Sequence[tuple[Effect, Mapping[str, float]]], signal: Array, context: Context
) -> tuple[list[Passage], Array, Context]:
    """How small changes pass through effects that follow each other, with the signal and the context behind them."""
    found = []
    for effect, values in effects:
        forward, slope = effect.forward, None
        if effect.form == "memoryless":
            step = 1e-5 * (float(np.ptp(signal)) + 1e-12)
            above, below = forward(signal + step, context, values), forward(signal - step, context, values)
            slope = (above - below) / (2.0 * step)
        found.append(Passage(effect, context, values, slope))
        signal = forward(signal, context, values)
        context = behind(effect, context)
    return found, signal, context
