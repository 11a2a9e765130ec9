"""Fit of linear dynamics without a name to the residual of all effects: lags and modes of the command.

Tables over the drivers of an unnamed law show no mode. Where the residual follows the command through modes or filters,
linear dynamics predict left-out blocks better. They are written as an unnamed law of the command.
"""

from collections.abc import Sequence

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.selection.significance import sign_test_p
from piezod.diagnose.selection.unnamed import AS_WELL, LEAST, SIGNIFICANT, FittedLaw
from piezod.estimation.fit.linear_dynamics import Driven, LinearDynamics, fit_linear_dynamics
from piezod.estimation.recordings.series import Series
from piezod.model.unnamed_law import Axis, LawStep, UnnamedLaw

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
    since = fit_linear_dynamics([recordings[k] for k in diagnosed])
    if since is None:
        return None
    chosen, already = since, False
    if len(diagnosed) < len(series) and (everywhere := fit_linear_dynamics(recordings)) is not None:
        pieces = np.concatenate(
            [np.full(everywhere.errors.size // len(series), k in diagnosed) for k in range(len(series))]
        )
        already = float(everywhere.errors[pieces].sum()) < AS_WELL * float(since.errors.sum())
        if already:
            chosen = LinearDynamics(
                everywhere.poles, everywhere.direct, everywhere.gains, everywhere.errors[pieces], since.references
            )
    p = min(1.0, TRIED * sign_test_p(np.log(chosen.references / chosen.errors)))
    variance, samples = 0.0, 0
    for k in diagnosed:
        error = recordings[k].residual[recordings[k].counts]
        variance, samples = variance + float(error.size * np.var(error)), samples + error.size
    before = float(np.sqrt(variance / max(samples, 1)))
    after = before * float(np.sqrt(max(1.0 - chosen.explained, 0.0)))
    if p > SIGNIFICANT or before**2 - after**2 < LEAST * max(before**2 - floor**2, 0.0):
        return None
    law = _law(chosen, series, [series[k] for k in diagnosed])
    lags_s = tuple(one for one in law.memories_s if one > 0.0)
    return FittedLaw(law, before, after, p, lags_s, already, None)


def _law(dynamics: LinearDynamics, series: Sequence[Series], diagnosed: Sequence[Series]) -> UnnamedLaw:
    """Dynamics as an unnamed law of the command, without mean over the diagnosed recordings."""
    low, high = min(float(s.command_V.min()) for s in series), max(float(s.command_V.max()) for s in series)
    memories_s, rows, modes = dynamics.tables((low, high))
    law = UnnamedLaw(
        drivers=(Axis(driver="command", low=low, high=high, nodes=2),),
        dead_band=1e-6 * (high - low),
        smoothing_s=max(s.dt_s for s in series),
        memories_s=tuple(memories_s),
        tables=tuple(tuple(row) for row in rows),
        modes=tuple(modes),
    )
    added = [LawStep(law, s.dt_s).run(s.command_V, s.command_V)[s.counts] for s in diagnosed]
    tare = float(np.mean(np.concatenate(added)))
    rows[0] = [value - tare for value in rows[0]]
    return law.model_copy(update={"tables": tuple(tuple(row) for row in rows)})
