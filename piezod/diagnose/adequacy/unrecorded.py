"""An input that is not recorded: what is left is no fast noise, and follows no function of the drive.

A disturbance that keeps its value for some samples leaves residuals whose neighbours are alike. Where a law of the
stack is missing, the drive predicts them. Where another input acts, the drive does not. Where their power grows with
the distance of the force from some level, the input acts as a gain. Derived here.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.findings import Unrecorded
from piezod.diagnose.hypothesis.series import Series

Array = NDArray[np.float64]

UNPREDICTED = 0.3
"""Largest share of what is left that the drive predicts: with more, a law of the drive is missing besides."""
SLOWER = 4.0  # rms of what is left over its fast part: an AR(1) residual keeps 0.97 of its value from sample to sample
ALIKE = 0.5  # correlation with a later sample until which a value counts as kept
CLEARLY = 3.0  # of log-likelihood, by which a gain must be likelier than what adds: one in twenty
BESIDE, TRIED, REFINED = 0.5, 61, 5  # of the force's range; levels about which a gain may turn; rounds of weights


def unrecorded_input(
    series: Sequence[Series], residuals: Sequence[Array], modelled: Sequence[Array], predicted: float
) -> Unrecorded | None:
    """Size and place of an input that is not recorded; None where nothing speaks for one.

    Parameters
    ----------
    series
        Only those with the role "recording" are looked at.
    residuals, modelled
        Reading less simulation, and simulation, each shape (N,) [N].
    predicted
        Share of what is left that the drive predicts.
    """
    told = [
        (one.counts, np.where(one.counts, left - left[one.counts].mean(), 0.0), by, one.dt_s)
        for one, left, by in zip(series, residuals, modelled, strict=True)
        if one.role == "recording"
    ]
    left = np.concatenate([residual[counts] for counts, residual, _, _ in told])
    bends = np.concatenate([np.diff(residual, 2)[counts[1:-1]] for counts, residual, _, _ in told])
    fast = 1.4826 * float(np.median(np.abs(bends))) / np.sqrt(6.0)  # of white noise
    size = float(np.sqrt(np.mean(left**2)))
    if predicted > UNPREDICTED or size < SLOWER * fast:
        return None
    force = np.concatenate([by[counts] for counts, _, by, _ in told])
    keeps_s = float(np.median([_kept(residual) * dt_s for _, residual, _, dt_s in told]))
    duration_s = sum(residual.size * dt_s for _, residual, _, dt_s in told)
    relative = _as_gain(force, left, max(fast, 1e-3 * size), max(duration_s / max(keeps_s, 1e-9), 1.0))
    return Unrecorded(size if relative is None else relative, relative is not None, keeps_s)


def _kept(residual: Array) -> int:
    """Samples after which a residual is no longer alike."""
    spectrum = np.abs(np.fft.rfft(residual, 2 * residual.size)) ** 2
    alike = np.fft.irfft(spectrum)[: residual.size]
    unlike = np.flatnonzero(alike < ALIKE * alike[0])
    return int(unlike[0]) if unlike.size else residual.size


def _as_gain(force: Array, left: Array, fast: float, independent: float) -> float | None:
    """Relative size of a gain that leaves these residuals; None where one that adds is as likely.

    Both are normal, with the variance s^2 (F - c)^2 + fast^2 and with the same variance everywhere; c may lie beside
    the range. `independent`: how many values the input had.
    """
    power = left**2
    best, size = 1.0 + np.log(np.mean(power)), None  # minus twice the log-likelihood a value, of one that adds
    best -= 2.0 * CLEARLY / independent
    low, span = float(force.min()), float(np.ptp(force))
    for about in np.linspace(low - BESIDE * span, low + (1.0 + BESIDE) * span, TRIED):
        away = (force - about) ** 2
        square = max(float(np.sum((power - fast**2) * away) / np.sum(away**2)), 0.0)
        for _ in range(REFINED):  # weighted by what was found
            variance = square * away + fast**2
            weights = (away / variance) ** 2
            square = max(float(np.sum((power - fast**2) * away / variance**2) / np.sum(weights)), 0.0)
        variance = square * away + fast**2
        score = float(np.mean(np.log(variance) + power / variance))
        if score < best:
            best, size = score, np.sqrt(square)
    return None if size is None else float(size)
