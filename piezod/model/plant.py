"""The forward chain: from the commanded voltage to the reading that the model expects."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.effects import EFFECTS, Context, Effect, Location
from piezod.model.parameters import Model
from piezod.model.unnamed_law import LawStep
from piezod.operators import PrandtlIshlinskii
from piezod.recording.hold import HELD_BEFORE, STRAIGHT

Array = NDArray[np.float64]


class Plant:
    """Hysteresis of a model, run forward.

    Parameters
    ----------
    model
        Identified model; the plant begins in its start state.

    Attributes
    ----------
    model
        The model.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._operator = model.operator()

    def reset(self) -> None:
        """Return to the model's start state."""
        self._operator = self.model.operator()

    def step(self, voltage_V: float) -> float:
        """Force [unit of the model's output] after one more sample at `voltage_V` [V]."""
        return self._operator.step(voltage_V)

    def run(self, voltage_V: ArrayLike) -> NDArray[np.float64]:
        """Forces [unit of the model's output], shape (N,), of the voltages `voltage_V` [V], shape (N,)."""
        return self._operator.run(voltage_V)

    def steady_range(self) -> tuple[float, float]:
        """Force of the steady major loop at the low and at the high end of the input range."""
        operator = self.model.operator()
        low, high = self.model.input.low, self.model.input.high
        _, _, top, bottom = operator.run([low, high, high, low])
        return float(bottom), float(top)


def _acting_in(model: Model, sha256: str | None = None) -> list[tuple[Effect, dict[str, float]]]:
    """Effects of the model that act in a recording, in the order of the signal chain.

    Parameters
    ----------
    model
        Identified or diagnosed model.
    sha256
        SHA-256 of the recording's file. Effects that belong to another recording do not act.
    """
    order = {name: place for place, name in enumerate(EFFECTS)}
    acting = [entry for entry in model.effects if entry.recording is None or entry.recording == sha256]
    return [(EFFECTS[entry.name], entry.parameters) for entry in sorted(acting, key=lambda entry: order[entry.name])]


def run_chain(
    model: Model,
    operator: PrandtlIshlinskii,
    time_s: Array,
    command_V: Array,
    *,
    temperature_C: Array | None = None,
    sha256: str | None = None,
    path_V: tuple[float, ...] = (),
) -> Array:
    """Readings that the model expects over a recording, shape (N,) [unit of the model's output].

    Parameters
    ----------
    model
        Model with its effects and its sampling.
    operator
        The model's operator, in the state at the start of the recording; its state advances.
    time_s, command_V
        Times [s] and commanded voltages [V] of the recording, shape (N,); equal steps where the model has effects or an
        unnamed law.
    temperature_C
        Temperatures [degC], shape (N,); None where they were not recorded.
    sha256
        SHA-256 of the recording's file.
    path_V
        Voltages that led the operator to its state [V].
    """
    readings = _with_effects(model, operator, time_s, command_V, temperature_C, sha256, path_V)
    if model.unnamed_law is not None:
        readings = readings + LawStep(model.unnamed_law, _spacing_s(time_s)).run(command_V, readings)
    return readings


def decays_of(model: Model, time_s: Array, sha256: str | None = None) -> list[Array]:
    """What a past that is not known adds to the readings through each effect, each shape (N, columns) [1].

    Parameters
    ----------
    model
        Model with its effects.
    time_s
        Times of the recording, shape (N,) [s].
    sha256
        SHA-256 of the recording's file.
    """
    seconds = time_s - time_s[0]
    force_span, voltage_span = model.output.high - model.output.low, model.input.high - model.input.low
    context = Context(
        _spacing_s(seconds),
        seconds,
        seconds,  # the decays depend on no voltage
        seconds,
        float(seconds[-1]),
        force_span,
        None,
        model.hold,
        voltage_span,
    )
    acting = [(effect.past, values) for effect, values in _acting_in(model, sha256)]
    return [past.columns(context, values) for past, values in acting if past is not None]


def _spacing_s(time_s: Array) -> float:
    return float(np.median(np.diff(time_s)))


def _with_effects(
    model: Model,
    operator: PrandtlIshlinskii,
    time_s: Array,
    command_V: Array,
    temperature_C: Array | None,
    sha256: str | None,
    path_V: tuple[float, ...],
) -> Array:
    """Readings of hysteresis and effects; parameters as for `run_chain`."""
    effects = _acting_in(model, sha256)
    if not effects and model.hold != HELD_BEFORE:
        return operator.run(command_V)
    if model.hold == HELD_BEFORE:
        command_V = np.concatenate((command_V[:1], command_V[:-1]))
    seconds = time_s - time_s[0]
    context = Context(
        _spacing_s(seconds),
        seconds,
        command_V,
        command_V,
        float(seconds[-1]),
        model.output.high - model.output.low,
        temperature_C,
        model.hold,
        model.input.high - model.input.low,
        path_V,
        model.seen_s,
        model.hysteresis.stroke_per_V,
    )
    signal = command_V
    for effect, values in _located(effects, Location.AMPLIFIER, Location.AMPLIFIER):
        signal = effect.forward(signal, context, values)
        context = behind(effect, replace(context, applied_V=signal, cache={}))
    factor, offset_V = _widening(effects, context)
    signal = operator.stroke(signal, factor, offset_V)
    for effect, values in _located(effects, Location.STACK, Location.STACK):
        signal = effect.forward(signal, context, values)
        context = behind(effect, context)
    signal = operator.output(signal)
    for effect, values in _located(effects, Location.MECHANICS, Location.ACQUISITION):
        signal = effect.forward(signal, context, values)
        context = behind(effect, context)
    return signal


def _widening(
    effects: Sequence[tuple[Effect, dict[str, float]]], context: Context
) -> tuple[Array | None, Array | None]:
    """Factor and offset of the play thresholds, each of shape (N,) or None."""
    factor: Array | None = None
    offset_V: Array | None = None
    for effect, values in effects:
        if effect.widening is not None:
            wider, more_V = effect.widening(context, values)
            factor = wider if factor is None else factor * wider
            offset_V = more_V if offset_V is None else offset_V + more_V
    return factor, offset_V


def behind(effect: Effect, context: Context) -> Context:
    """Context of the signal behind an effect; an effect that smooths makes it run straight between samples.

    Parameters
    ----------
    effect
        Effect that the signal has passed.
    context
        Context in front of the effect.
    """
    return replace(context, hold=STRAIGHT) if effect.smooths else context


def _located(
    effects: Sequence[tuple[Effect, dict[str, float]]], first: Location, last: Location
) -> list[tuple[Effect, dict[str, float]]]:
    return [(effect, values) for effect, values in effects if first <= effect.location <= last]
