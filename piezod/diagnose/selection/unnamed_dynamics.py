"""Fit of linear dynamics without a name to the residual of all effects: lags and modes of the command.

Tables over the drivers of an unnamed law show no mode. Where the residual follows the command through modes or filters,
linear dynamics predict left-out blocks better. They are written as an unnamed law of the command.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.hypothesis.left_out import sign_test_p
from piezod.diagnose.selection.unnamed import AS_WELL, LEAST, SIGNIFICANT, FittedLaw
from piezod.estimation.fit.linear_dynamics import LinearDynamics, fit_linear_dynamics
from piezod.estimation.fit.pole_starts import Driven
from piezod.estimation.recordings.series import Series
from piezod.model.unnamed_law import LawStep

TRIED = 10  # numbers of poles that are compared, which the p-value counts as trials


def fit_unnamed_dynamics(series: Sequence[Series], modelled: Sequence[Array], floor: float) -> FittedLaw | None:
    """Fit linear dynamics of the command; None if they do not predict the residual.

    `modelled`: readings of the written model, shape (N,) each; `floor`: noise; all in [output unit].
    """
    recordings = [
        Driven(s.command_V, s.reading_N - model, s.counts, s.dt_s, s.noise_N)
        for s, model in zip(series, modelled, strict=True)
    ]
    diagnosed = [k for k, s in enumerate(series) if s.role == "recording"]
    chosen = fit_linear_dynamics([recordings[k] for k in diagnosed])
    if chosen is None:
        return None
    everywhere = _everywhere(recordings, diagnosed, chosen) if len(diagnosed) < len(series) else None
    already, chosen = everywhere is not None, everywhere or chosen
    p = min(1.0, TRIED * sign_test_p(np.log(chosen.references / chosen.errors)))
    variance, samples = 0.0, 0
    for k in diagnosed:
        error = recordings[k].residual[recordings[k].counts]
        variance, samples = variance + float(error.size * np.var(error)), samples + error.size
    before = float(np.sqrt(variance / max(samples, 1)))
    after = before * float(np.sqrt(max(1.0 - chosen.explained, 0.0)))
    if p > SIGNIFICANT or before**2 - after**2 < LEAST * max(before**2 - floor**2, 0.0):
        return None
    commands, dt_s = [s.command_V for s in series], max(s.dt_s for s in series)
    law = chosen.as_law("command", commands, dt_s)
    added = [LawStep(law, series[k].dt_s).run(commands[k], commands[k])[series[k].counts] for k in diagnosed]
    law = chosen.as_law("command", commands, dt_s, tare=float(np.mean(np.concatenate(added))))
    lags_s = tuple(memory_s for memory_s in law.memories_s if memory_s > 0.0)
    return FittedLaw(law, before, after, p, lags_s, already, None)


def _everywhere(recordings: Sequence[Driven], diagnosed: Sequence[int], since: LinearDynamics) -> LinearDynamics | None:
    """Dynamics of all recordings; None: a fit of the diagnosed recordings only predicts these much better."""
    fitted = fit_linear_dynamics(recordings, since.poles)
    if fitted is None:
        return None
    errors = fitted.errors.reshape(len(recordings), -1)[diagnosed].ravel()
    if float(errors.sum()) >= AS_WELL * float(since.errors.sum()):
        return None
    return replace(fitted, errors=errors, references=since.references)
