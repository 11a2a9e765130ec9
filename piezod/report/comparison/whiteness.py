"""Whether what a model leaves is white and independent of the input: the test that MATLAB's `resid` makes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.errors import UsageError
from piezod.identify.scores import rms
from piezod.identify.simulation import simulate
from piezod.model import Model
from piezod.recording import Recording

Array = NDArray[np.float64]

LAGS = 25  # as MATLAB shows
DEVIATIONS_99 = 2.58  # standard deviations of a normal variable within which 99 % lie, as MATLAB rounds it
MOST_SAMPLES = 2**27


@dataclass(frozen=True)
class ResidualTest:
    """Correlations of a residual, normalised, with the bounds that 99 % of them would keep.

        R_ab(k) = 1/N sum_t a(t + k) b(t)                       (means removed; pairs that are not both known left out)
        auto(k) = R_ee(k) / R_ee(0),                            bound 2.58 / sqrt(N)
        cross(k) = R_eu(k) / sqrt(R_ee(0) R_uu(0)),             bound 2.58 sqrt(P / N),
        P = 1 + 2 sum_{k=1}^{lags} auto(k) R_uu(k) / R_uu(0)

    Under the hypothesis that the residual is white and independent of the input. At k > 0 the residual follows the
    input. Source: L. Ljung, `resid.m` of MATLAB's System Identification Toolbox (1986, revision of 2001), which was
    opened. Its `covf` removes no means; here they are removed, since a bench's input has one.

    Parameters
    ----------
    samples
        N, of the residual that are known.
    dt_s
        One lag [s].
    mean, rms
        Of the residual, in the output's unit; the mean is not part of the correlations.
    auto
        Shape (lags + 1,), from lag 0.
    auto_bound
        Of its lags but the first.
    cross
        Shape (2 lags + 1,), from -lags.
    cross_bound
        Of all its lags.
    """

    samples: int
    dt_s: float
    mean: float
    rms: float
    auto: Array
    auto_bound: float
    cross: Array
    cross_bound: float

    @property
    def auto_outside(self) -> int:
        """Lags of the autocorrelation beyond the bound, the first left out."""
        return int(np.count_nonzero(np.abs(self.auto[1:]) > self.auto_bound))

    @property
    def cross_outside(self) -> int:
        """Lags of the cross-correlation beyond the bound."""
        return int(np.count_nonzero(np.abs(self.cross) > self.cross_bound))

    @property
    def words(self) -> str:
        """The verdict in a sentence."""
        lags = self.auto.size - 1
        if not self.auto_outside and not self.cross_outside:
            return f"residual is white and independent of the input, as far as {lags} lags tell (99 % bounds)"
        said = []
        if self.auto_outside:
            said.append(f"not white: {self.auto_outside} of {lags} lags beyond the 99 % bound")
        if self.cross_outside:
            said.append(f"follows the input: {self.cross_outside} of {self.cross.size} lags beyond the 99 % bound")
        return f"residual is {'; '.join(said)}"


def residual_test(recording: Recording, residual: Array, input_column: str, lags: int = LAGS) -> ResidualTest:
    """Test what a model leaves.

    Parameters
    ----------
    recording
        Its times and the input; a tick that is missing is a gap, over which nothing is correlated.
    residual
        Measured minus modelled, shape (N,), in the output's unit; nan where not known.
    input_column
        Of the recording.
    lags
        How many are looked at, at least 1.

    Raises
    ------
    UsageError
        There are fewer than four times as many samples as lags, times lie on no grid, or residual or input is constant.
    """
    known = np.isfinite(residual)
    if np.count_nonzero(known) < 4 * max(lags, 1):
        raise UsageError(
            f"{recording.source}: {np.count_nonzero(known)} samples to test, need at least {4 * lags} for {lags} lags"
        )
    dt_s = recording.dt_s
    place = _places(recording, dt_s)
    e, u = (np.full(int(place[-1]) + 1, np.nan) for _ in range(2))
    e[place], u[place] = residual, recording.channel(input_column)
    mean = float(np.nanmean(e))
    e -= mean
    u -= np.nanmean(u)
    r_e, r_u = (np.array([_covariance(one, one, k) for k in range(lags + 1)]) for one in (e, u))
    if r_e[0] <= 0.0 or r_u[0] <= 0.0:
        raise UsageError(f"{recording.source}: {'the residual' if r_e[0] <= 0.0 else input_column} is constant")
    r_eu = np.array([_covariance(e, u, k) if k >= 0 else _covariance(u, e, -k) for k in range(-lags, lags + 1)])
    samples = int(np.count_nonzero(np.isfinite(e)))
    auto = r_e / r_e[0]
    spread = max(0.0, 1.0 + 2.0 * float(np.sum(auto[1:] * r_u[1:] / r_u[0])))
    return ResidualTest(
        samples=samples,
        dt_s=dt_s,
        mean=mean,
        rms=rms(residual[known]),
        auto=auto,
        auto_bound=DEVIATIONS_99 / np.sqrt(samples),
        cross=r_eu / np.sqrt(r_e[0] * r_u[0]),
        cross_bound=DEVIATIONS_99 * float(np.sqrt(spread / samples)),
    )


def residual_of(model: Model, recording: Recording, start_window_s: float, sha256: str | None = None) -> Array:
    """Measured minus simulated output in free run, shape (N,), in the output's unit; nan in the first stretch.

    Parameters
    ----------
    model
        What was identified.
    recording
        Has its input and its output.
    start_window_s
        First stretch that may be looked at to find what the memory starts with [s].
    sha256
        Of the recording's file.

    Raises
    ------
    RecordingError
        A column is missing.
    """
    measured = recording.channel(model.output.channel)
    window = int(np.searchsorted(recording.time_s, recording.time_s[0] + start_window_s))
    simulated, _ = simulate(model, recording, window, sha256)
    left: Array = measured - simulated
    left[:window] = np.nan
    return left


def _places(recording: Recording, dt_s: float) -> NDArray[np.int64]:
    """Number of the period that each sample falls into."""
    place: NDArray[np.int64] = np.rint((recording.time_s - recording.time_s[0]) / dt_s).astype(np.int64)
    if (np.diff(place) < 1).any() or place[-1] >= MOST_SAMPLES:
        raise UsageError(
            f"{recording.source}: times lie on no grid of {dt_s:g} s, which correlations need; resample the recording"
        )
    return place


def _covariance(a: Array, b: Array, lag: int) -> float:
    """1/N sum a(t + lag) b(t) over the pairs that are known, N the samples of which both may be."""
    products = a[lag:] * b[: b.size - lag]
    known = np.isfinite(products)
    full = int(np.count_nonzero(np.isfinite(a) & np.isfinite(b)))
    return float(products[known].sum() / max(full, 1))
