"""The forward chain over a record: from the commanded voltage to the reading that a model expects.

    command -> amplifier -> plays -> stack -> force law -> mechanics, load cell, acquisition -> reading

A diagnosis walks over the same pieces (`amplified`, `widening`, `through`) with plays and a force law of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from piezod.arrays import Array
from piezod.effects import Context, Effect, Location
from piezod.model.chain.acting import acting_in
from piezod.model.parameters import Model
from piezod.model.unnamed_law import LawStep
from piezod.operators import PrandtlIshlinskii
from piezod.recording.hold import HELD_BEFORE, STRAIGHT, Hold

Acting = Sequence[tuple[Effect, Mapping[str, float]]]
"""Effects with their parameter values, in the order of the signal chain."""


def located(acting: Acting, first: Location, last: Location) -> Acting:
    """Effects from one location to another."""
    return [(effect, values) for effect, values in acting if first <= effect.location <= last]


def behind(effect: Effect, context: Context) -> Context:
    """Context of the signal behind an effect; an effect that smooths makes it run straight between samples."""
    if not effect.smooths:
        return context
    drive_hold = STRAIGHT if effect.location is Location.AMPLIFIER else context.drive_hold or context.hold
    return replace(context, hold=STRAIGHT, drive_hold=drive_hold)


def as_sampled(command_V: Array, hold: Hold) -> Array:
    """Command as it stands when the readings are taken, shape (N,) [V]."""
    return np.concatenate((command_V[:1], command_V[:-1])) if hold == HELD_BEFORE else command_V


def amplified(acting: Acting, context: Context) -> Context:
    """Context behind the amplifier: `applied_V` is the voltage at the stack."""
    for effect, values in located(acting, Location.AMPLIFIER, Location.AMPLIFIER):
        applied_V = effect.forward(context.applied_V, context, values)
        context = behind(effect, replace(context, applied_V=applied_V, cache={}))
    return context


def widening(acting: Acting, context: Context) -> tuple[Array | None, Array | None]:
    """Factor [1] and offset [V] of the play thresholds, each of shape (N,); None without an effect on them."""
    factor: Array | None = None
    offset_V: Array | None = None
    for effect, values in acting:
        if effect.widening is not None:
            wider, more_V = effect.widening(context, values)
            factor = wider if factor is None else factor * wider
            offset_V = more_V if offset_V is None else offset_V + more_V
    return factor, offset_V


def through(acting: Acting, signal: Array, context: Context) -> tuple[Array, Context]:
    """Signal behind effects, shape (N,), and the context there."""
    for effect, values in acting:
        signal = effect.forward(signal, context, values)
        context = behind(effect, context)
    return signal, context


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
    """Decays of an unknown past in the readings, of each effect with a long memory and of the law; (N, columns) [1].

    Parameters
    ----------
    time_s
        Times of the recording, shape (N,) [s].
    sha256
        SHA-256 of the recording's file.
    """
    context = _context(model, time_s, time_s)  # the decays depend on no voltage
    acting = [(effect.past, values) for effect, values in acting_in(model, sha256)]
    columns = [past.columns(context, values) for past, values in acting if past is not None]
    return columns if model.unnamed_law is None else [*columns, model.unnamed_law.decays(time_s - time_s[0])]


def _spacing_s(time_s: Array) -> float:
    return float(np.median(np.diff(time_s)))


def _context(model: Model, time_s: Array, command_V: Array) -> Context:
    seconds = time_s - time_s[0]
    return Context(
        _spacing_s(seconds),
        seconds,
        command_V,
        command_V,
        float(seconds[-1]),
        model.output.high - model.output.low,
        hold=model.hold,
        voltage_span_V=model.input.high - model.input.low,
        seen_s=model.seen_s,
        stroke_per_V=model.hysteresis.stroke_per_V,
    )


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
    acting = acting_in(model, sha256)
    if not acting and model.hold != HELD_BEFORE:
        return operator.run(command_V)
    context = _context(model, time_s, as_sampled(command_V, model.hold))
    context = amplified(acting, replace(context, temperature_C=temperature_C, path_V=path_V))
    stroke_V = operator.stroke(context.applied_V, *widening(acting, context))
    stroke_V, context = through(located(acting, Location.STACK, Location.STACK), stroke_V, context)
    behind_law = located(acting, Location.MECHANICS, Location.ACQUISITION)
    return through(behind_law, operator.output(stroke_V), context)[0]
