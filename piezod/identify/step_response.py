"""Response of the bench to a step of the static model's output, estimated from an identification record.

    measured(t) = offset + sum over k of S(k) [modelled(t - k) - modelled(t - k - 1)] + S(last) modelled(t - last)

S is the share of a step that the measurement shows k samples later, by least squares, linear between `KNOTS`. A bench
without dynamics has S = 1 from 0 on. Lags before 0 are a control: there S must be 0. The band is the spread of S
between parts of the record, because the residual is not white.

Both records first pass the filter that whitens the residual (Yule and Walker), so that a hum does not widen the band. A
linear filter of both leaves S as it is. Derived here.
"""

from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.estimation.fit.blocks import Blocks, spread
from piezod.estimation.recordings.series import equal_parts

KNOTS = np.array([-4, -2, -1, 0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])
"""Lags at which S is estimated [samples]; denser near the step, where it changes fastest."""
BEFORE = int(np.count_nonzero(KNOTS < 0))
PARTS = 8  # parts of the record that give the band
MOST_SAMPLES = 160_000  # evenly chosen pieces of a longer record: 0.3 s of one core
WIDEST_BAND = 0.2  # a step with a band of more than +- 20 % does not show a response
ACAUSAL = 0.1  # largest |S| before the step, beyond its band: more means that the record has another clock or hold
WHITENED = 32  # order of the whitening filter; a hum takes two
RIDGE = 1e-6  # of the residual's variance: a constant residual has no filter
STANDARD_ERRORS = 2.36  # 95 % of Student's t with PARTS - 1 degrees of freedom
FEWEST_ROWS = 20 * KNOTS.size  # samples of a part


@dataclass(frozen=True)
class StepResponse:
    """A step response and its band.

    Parameters
    ----------
    lag_s
        Time since the step [s], shape (K,); the first `BEFORE` are negative.
    response
        Share of the step [1], shape (K,).
    band
        Half width of its 95 % confidence interval [1], shape (K,).
    """

    lag_s: Array
    response: Array
    band: Array

    @property
    def is_shown(self) -> bool:
        """Whether the record determines the response: a narrow band, and nothing before the step."""
        early = np.abs(self.response[:BEFORE]) - self.band[:BEFORE]
        return bool(self.band.max() <= WIDEST_BAND and early.max() <= ACAUSAL)

    @property
    def rise_s(self) -> float | None:
        """Time from the step until the response reaches and keeps 90 % of its last value [s]; None: at once."""
        after = self.response[BEFORE:]
        low = np.flatnonzero(after < 0.9 * after[-1])
        return None if low.size == 0 or low[-1] + 1 >= after.size else float(self.lag_s[BEFORE + low[-1] + 1])


def step_response(measured: Array, modelled: Array, dt_s: float) -> StepResponse | None:
    """Estimate the response; None: too few samples, or the model does not move.

    Parameters
    ----------
    measured, modelled
        Measured output, nan where missing, and output of the static model, shape (N,) [output unit].
    dt_s
        Sample period [s].
    """
    if not np.isfinite(modelled).all() or measured.size < PARTS * FEWEST_ROWS:
        return None
    parts, most = equal_parts(measured.size, PARTS), MOST_SAMPLES // PARTS
    pieces = [(measured[part][:most], modelled[part][:most]) for part in parts]
    taps = _whitening([y - x for y, x in pieces])
    moments = [_moments(*_filtered(y, x, taps)) for y, x in pieces]
    known = [moment for moment in moments if moment is not None]
    if len(known) < PARTS:
        return None
    sums = Blocks.all_of(known)
    # a part alone may not move enough, all others together do
    errors = STANDARD_ERRORS * np.sqrt(np.diag(spread(sums.without())))
    shown = slice(0, -1)  # the last value stands for all that comes later
    return StepResponse(dt_s * KNOTS[shown], sums.solve()[shown], errors[shown])


def _whitening(residuals: list[Array]) -> Array:
    """Filter that whitens the residuals, shape (WHITENED + 1,); a missing sample counts as their mean."""
    covariance = np.zeros(WHITENED + 1)
    mean = float(np.nanmean(np.concatenate(residuals))) if any(np.isfinite(r).any() for r in residuals) else 0.0
    for residual in residuals:
        centred = np.where(np.isfinite(residual), residual - mean, 0.0)
        power = np.abs(np.fft.rfft(centred, 2 * centred.size)) ** 2
        covariance += np.fft.irfft(power, 2 * centred.size)[: WHITENED + 1]
    if covariance[0] <= 0.0:
        return np.ones(1)
    covariance[0] *= 1.0 + RIDGE
    lags = np.subtract.outer(np.arange(WHITENED), np.arange(WHITENED))
    return np.concatenate(([1.0], -np.linalg.solve(covariance[np.abs(lags)], covariance[1:])))


def _filtered(measured: Array, modelled: Array, taps: Array) -> tuple[Array, Array]:
    """Both records through a filter; nan where it reaches a missing sample."""
    present = np.isfinite(measured)
    filtered = np.convolve(np.where(present, measured, 0.0), taps, mode="valid")
    reached = np.convolve(~present, np.ones(taps.size), mode="valid") > 0.5
    return np.where(reached, np.nan, filtered), np.convolve(modelled, taps, mode="valid")


def _moments(measured: Array, modelled: Array) -> Blocks | None:
    """Sums of one part, without its means; None where it is too short or does not move."""
    changes = np.diff(modelled)
    first, last = int(KNOTS[0]), int(KNOTS[-1])
    width = last - first
    if changes.size < FEWEST_ROWS + width or np.ptp(modelled) == 0.0:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(changes, width)[:, ::-1]  # column k: lag first + k
    weights = np.column_stack([np.interp(np.arange(first, last), KNOTS, row) for row in np.eye(KNOTS.size)])
    rows = windows.shape[0]
    table = windows @ weights
    table[:, -1] += modelled[:rows]  # the sum of all changes before the window
    wanted = measured[last : last + rows]
    use = np.isfinite(wanted)
    if np.count_nonzero(use) < FEWEST_ROWS:
        return None
    centred: Array = table[use] - table[use].mean(axis=0)
    return Blocks.of(centred, wanted[use] - wanted[use].mean(), [slice(None)])
