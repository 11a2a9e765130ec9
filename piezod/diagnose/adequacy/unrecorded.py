"""Unrecorded input: a slow residual that no function of the drive predicts.

A disturbance that keeps its value for some samples leaves a residual with correlated neighbours. If an effect of the
stack is missing, the drive predicts this residual; if another input acts, it does not. The input acts as a gain if the
residual's power grows with the distance of the force from some level. Derived here.
"""

from collections.abc import Sequence

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.findings import Unrecorded
from piezod.estimation.recordings.noise import white_noise
from piezod.estimation.recordings.series import Series

MOST_PREDICTED = 0.3  # largest share of the residual that the drive predicts; with more, an effect is missing
SLOW = 4.0  # least ratio of the residual's rms to its fast part; AR(1) with a coefficient of 0.97 has this ratio
CORRELATED = 0.5  # autocorrelation below which the input counts as changed
HELD = 2.0  # a value that is held for T has an autocorrelation of 1 - lag / T, which falls to a half at T / 2
LIKELIER = 3.0  # least log-likelihood ratio of a gain over an added input: odds of 20
CERTAIN = 10.0  # as above, for a model that matches: slow noise reached 3 in 3 of 600 draws, and 10 in none
MARGIN, LEVELS = 0.5, 61  # margin beyond the force range, relative to it, and number of levels that are tried
REWEIGHTINGS = 5  # rounds of iteratively reweighted least squares


def unrecorded_input(
    series: Sequence[Series],
    residuals: Sequence[Array],
    modelled: Sequence[Array],
    predicted: float,
    likelier: float = LIKELIER,
) -> Unrecorded | None:
    """Size and duration of an unrecorded input in the diagnosed recordings; None if there is no sign of one.

    `residuals` and `modelled` have shape (N,) each [N]; `predicted`: share of the residual that the drive predicts;
    `likelier`: least log-likelihood ratio of a gain over an added input.
    """
    recordings = [
        (s.counts, np.where(s.counts, residual - residual[s.counts].mean(), 0.0), model_N, s.dt_s)
        for s, residual, model_N in zip(series, residuals, modelled, strict=True)
        if s.role == "recording"
    ]
    compared = np.concatenate([residual[counts] for counts, residual, _, _ in recordings])
    differences = np.concatenate([np.diff(residual, 2)[counts[1:-1]] for counts, residual, _, _ in recordings])
    fast = white_noise(np.abs(differences))
    size = float(np.sqrt(np.mean(compared**2)))
    if predicted > MOST_PREDICTED or size < SLOW * fast:
        return None
    force = np.concatenate([model_N[counts] for counts, _, model_N, _ in recordings])
    correlated_s = float(np.median([_correlation_length(residual) * dt_s for _, residual, _, dt_s in recordings]))
    duration_s = sum(residual.size * dt_s for _, residual, _, dt_s in recordings)
    relative = _size_as_gain(
        force, compared, max(fast, 1e-3 * size), max(duration_s / max(correlated_s, 1e-9), 1.0), likelier
    )
    return Unrecorded(size if relative is None else relative, relative is not None, HELD * correlated_s, fast)


def _correlation_length(residual: Array) -> int:
    """Lag at which the autocorrelation of a residual falls below `CORRELATED` [samples]."""
    spectrum = np.abs(np.fft.rfft(residual, 2 * residual.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: residual.size]
    below = np.flatnonzero(correlation < CORRELATED * correlation[0])
    return int(below[0]) if below.size else residual.size


def _size_as_gain(force: Array, residual: Array, fast: float, independent: float, likelier: float) -> float | None:
    """Relative size s of a gain that explains the residual; None if an added input is as likely.

    The residual is normal. Its variance is s^2 (F - c)^2 + fast^2 for a gain and constant for an added input. The level
    c may lie outside the force range. `independent`: number of independent values of the input.
    """
    power = residual**2
    best, size = 1.0 + np.log(np.mean(power)), None  # minus twice the log-likelihood per value of an added input
    best -= 2.0 * likelier / independent
    low, span = float(force.min()), float(np.ptp(force))
    for level in np.linspace(low - MARGIN * span, low + (1.0 + MARGIN) * span, LEVELS):
        distance = (force - level) ** 2
        square = max(float(np.sum((power - fast**2) * distance) / np.sum(distance**2)), 0.0)
        for _ in range(REWEIGHTINGS):
            variance = square * distance + fast**2
            weights = (distance / variance) ** 2
            square = max(float(np.sum((power - fast**2) * distance / variance**2) / np.sum(weights)), 0.0)
        variance = square * distance + fast**2
        score = float(np.mean(np.log(variance) + power / variance))
        if score < best:
            best, size = score, np.sqrt(square)
    return None if size is None else float(size)
