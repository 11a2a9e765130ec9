"""Linear dynamics parallel to the hysteresis, where several modes or filters leave no usable static model.

The hysteresis is fitted to the readings less the dynamics, and the dynamics to the readings less the hysteresis, in
turn. The steady gain belongs to the hysteresis: the dynamics have none. They follow the command at first, then the
readings of the hysteresis: a mode behind the hysteresis moves with the force, not with the voltage.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezod.arrays import Array
from piezod.estimation.fit.linear_dynamics import LinearDynamics, fit_linear_dynamics
from piezod.estimation.fit.pole_starts import Driven, Poles
from piezod.estimation.recordings.unknown_past import fitted_past
from piezod.identify.options import Options
from piezod.identify.order import residual
from piezod.identify.selection import Selection, reduce_smooth_base
from piezod.model.parameters import FitFigures, Hysteresis
from piezod.model.unnamed_law import Driver, LawStep, UnnamedLaw
from piezod.recording import Recording

ROUNDS = 12  # fits in turn; with three modes behind plays the error still falls by 4 % a round
MOST_OF_ONE_POLE = 0.25
"""Largest squared error, relative to that of one pole, at which several poles are taken: one pole is a resonance, a lag
or a filter of the catalogue, which a diagnosis names and the inverse compensates."""
LEAST_EXPLAINED = 0.5  # least share of the squared readings of omitted folds that the dynamics must predict


@dataclass(frozen=True)
class HysteresisAndDynamics:
    """Linear dynamics, the hysteresis parallel to them, and figures of the sum."""

    law: UnnamedLaw
    selection: Selection
    hysteresis: Hysteresis
    figures: FitFigures


def hysteresis_and_dynamics(
    recordings: Sequence[Recording], pairs: Sequence[tuple[Array, Array]], options: Options, noise: float
) -> HysteresisAndDynamics | None:
    """Hysteresis and linear dynamics; None if the dynamics explain too little, or are one pole.

    Parameters
    ----------
    pairs
        Input and output of each recording, shape (N,); nan where missing.
    noise
        Noise of a reading, or any positive number where it is unknown [output unit].
    """
    static = [np.zeros(u.size) for u, _ in pairs]
    result: HysteresisAndDynamics | None = None
    poles: Poles | None = None
    for _ in range(ROUNDS):
        drives = [u for u, _ in pairs] if result is None else static
        driven = [
            _driven(r, drive, y - s, noise)
            for r, drive, (_, y), s in zip(recordings, drives, pairs, static, strict=True)
        ]
        dynamics = fit_linear_dynamics(driven, poles)
        if dynamics is None or (result is None and not _enough(dynamics)):
            return result
        poles = dynamics.poles
        driver: Driver = "command" if result is None else "reading"
        dynamics = replace(dynamics, direct=-float(dynamics.gains.real.sum()))
        dt_s, commands = max(recording.dt_s for recording in driven), [recording.command for recording in driven]
        law = dynamics.as_law(driver, commands, dt_s, since="identification")
        rest = [_without(law, r, drive, y) for r, drive, (_, y) in zip(recordings, drives, pairs, strict=True)]
        selection = reduce_smooth_base(recordings, [(u, y) for (u, _), y in zip(pairs, rest, strict=True)], options)
        if result is not None and selection.chosen.rms_held_out >= result.selection.chosen.rms_held_out:
            return result
        fit = selection.chosen.fit
        assert fit is not None
        figures = _relative_to(selection.figures, np.concatenate([y[np.isfinite(y)] for _, y in pairs]))
        result = HysteresisAndDynamics(law, selection, fit.hysteresis, figures)
        samples = [stretch.fitted for stretch in selection.stretches]
        if any(fitted.y.size != s.size for fitted, s in zip(samples, static, strict=True)):
            return result  # a part of a recording was not used, so its hysteresis is unknown there
        static = [fitted.y - residual(fit.hysteresis.operator(), fitted) for fitted in samples]
    return result


def _enough(dynamics: LinearDynamics) -> bool:
    several = float(dynamics.errors.sum()) < MOST_OF_ONE_POLE * dynamics.with_one_pole
    return several and dynamics.explained >= LEAST_EXPLAINED


def _relative_to(figures: FitFigures, measured: Array) -> FitFigures:
    """Figures whose fit refers to the measured readings."""
    spread = float(np.std(measured))
    return figures.model_copy(
        update={
            f"nrmse_percent_{part}": 100.0 * (1.0 - (getattr(figures, f"rms_{part}") or 0.0) / spread)
            for part in ("fit", "held_out")
        }
    )


def _without(law: UnnamedLaw, recording: Recording, drive: Array, y: Array) -> Array:
    """Readings minus the dynamics and the decays of their unknown past, shape (N,)."""
    drive = _filled(recording, drive)
    rest = y - LawStep(law, recording.dt_s).run(drive, drive)  # only one of both is its driver
    known = np.isfinite(rest)
    static = np.polynomial.Polynomial.fit(drive[known], rest[known], 1)
    less: Array = rest - fitted_past(rest - static(drive), law.decays(recording.time_s - recording.time_s[0]))
    return less


def _driven(recording: Recording, drive: Array, rest: Array, noise: float) -> Driven:
    counts = np.isfinite(drive) & np.isfinite(rest)
    return Driven(_filled(recording, drive), np.where(counts, rest, 0.0), counts, recording.dt_s, noise)


def _filled(recording: Recording, values: Array) -> Array:
    """Values with missing ones interpolated."""
    known = np.isfinite(values)
    return np.interp(recording.time_s, recording.time_s[known], values[known])
