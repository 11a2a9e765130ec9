"""How a small change of the signal passes through the effects that lie behind it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.effects.effect import Context, Effect
from piezod.model.chain.forward import behind

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Passage:
    """How a small change of the signal passes through an effect.

    Parameters
    ----------
    effect, context, values
        Which effect.
    slope
        Of a memoryless effect, or the factor of a scaling one, at every sample, shape (N,).
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
            return self.effect.forward(change, replace(self.context, stroke_per_V=0.0), self.values)
        return change if self.slope is None else change * self.slope[kept]


def unlike_signal(effect: Effect, values: Mapping[str, float], context: Context) -> Array:
    """What an effect does that depends on no signal: the factor of a scaling one, what an additive one adds.

    Parameters
    ----------
    effect
        Of one of these forms.
    values
        Of its parameters.
    context
        What it may look at.

    Returns
    -------
    Array
        At every sample, shape (N,).
    """
    size = context.time_s.size
    return effect.forward(np.ones(size) if effect.form == "scaling" else np.zeros(size), context, values)


def passages(
    effects: Sequence[tuple[Effect, Mapping[str, float]]], signal: Array, context: Context, step: int = 1
) -> tuple[list[Passage], Array, Context]:
    """How small changes pass through effects that follow each other, with the signal and the context behind them.

    Parameters
    ----------
    effects
        With their values.
    signal
        In front of them, at every `step`-th sample, shape (rows,). Beyond 1, none of them remembers the signal.
    context
        What they may look at, of all samples.
    step
        Samples from one of the signal's to the next.
    """
    found = []
    for effect, values in effects:
        forward, slope = effect.forward, None
        if effect.form == "memoryless":
            little = 1e-5 * (float(np.ptp(signal)) + 1e-12)
            above, below = forward(signal + little, context, values), forward(signal - little, context, values)
            slope = (above - below) / (2.0 * little)
        elif effect.form == "scaling":
            slope = unlike_signal(effect, values, context)[::step]
        found.append(Passage(effect, context, values, slope))
        if slope is not None and effect.form == "scaling":
            signal = signal * slope
        elif step > 1 and effect.form == "additive":
            signal = signal + unlike_signal(effect, values, context)[::step]
        else:
            signal = forward(signal, context, values)
        context = behind(effect, context)
    return found, signal, context
