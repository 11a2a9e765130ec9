"""Whiteness of a residual and its independence of the input, as MATLAB's `resid` computes them; text, JSON and page."""

import html
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models.annotations import BoxAnnotation
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.verdict.words import unit_words
from piezod.errors import UsageError
from piezod.identify.scores import rms
from piezod.identify.simulation import simulate
from piezod.model import Model
from piezod.recording import Recording
from piezod.report.figures.layout import finish_figure, labelled_figure
from piezod.report.figures.thinning import envelope, envelope_times
from piezod.report.next_step import NextStep
from piezod.report.page import Part, write_page
from piezod.report.style import BLUE, GREY, ORANGE

LAGS = 25  # MATLAB's default
DEVIATIONS_99 = 2.58  # 99 % of a normal variable lie within this many standard deviations, as MATLAB rounds it
MOST_SAMPLES = 2**27  # of the time grid, with its gaps
POINTS = 3000  # of a drawn curve


@dataclass(frozen=True)
class WhitenessTest:
    """Normalised correlations of a residual, with their 99 % bounds.

    Means are removed. Sums include only pairs of known values.

        R_ab(k)  = 1/N sum_t a(t + k) b(t)
        auto(k)  = R_ee(k) / R_ee(0);                  bound 2.58 / sqrt(N)
        cross(k) = R_eu(k) / sqrt(R_ee(0) R_uu(0));    bound 2.58 sqrt(P / N);
        P        = 1 + 2 sum_{k=1}^{lags} auto(k) R_uu(k) / R_uu(0)

    The bounds hold if the residual is white and independent of the input. At k > 0 the residual follows the input.

    Source: L. Ljung, `resid.m` of MATLAB's System Identification Toolbox (1986, revision of 2001). Its `covf` removes
    no means. This test removes them, because the input of a bench has a non-zero mean.

    Parameters
    ----------
    samples
        N, the number of known residuals.
    dt_s
        Length of one lag [s].
    mean, rms
        Mean and root mean square of the residual, in the output's unit. The correlations exclude the mean.
    auto
        Autocorrelation at lags 0 to `lags`, shape (lags + 1,).
    auto_bound
        Bound of the autocorrelation at lags 1 to `lags`.
    cross
        Correlation with the input at lags -`lags` to `lags`, shape (2 lags + 1,).
    cross_bound
        Bound of the correlation with the input, at all lags.
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
        """Number of lags from 1 on at which the autocorrelation exceeds its bound."""
        return int(np.count_nonzero(np.abs(self.auto[1:]) > self.auto_bound))

    @property
    def cross_outside(self) -> int:
        """Number of lags at which the correlation with the input exceeds its bound."""
        return int(np.count_nonzero(np.abs(self.cross) > self.cross_bound))

    @property
    def sentence(self) -> str:
        """Verdict in a sentence."""
        lags = self.auto.size - 1
        if not self.auto_outside and not self.cross_outside:
            return f"residual is white and independent of the input at {lags} lags (99 % bounds)"
        failures = []
        if self.auto_outside:
            failures.append(f"not white: {self.auto_outside} of {lags} lags beyond the 99 % bound")
        if self.cross_outside:
            lags = self.cross.size
            failures.append(f"correlated with the input: {self.cross_outside} of {lags} lags beyond the 99 % bound")
        return f"residual is {'; '.join(failures)}"


def whiteness_test(recording: Recording, residual: Array, input_column: str, lags: int = LAGS) -> WhitenessTest:
    """Test whether a residual is white and independent of the input.

    Parameters
    ----------
    recording
        Times and input. Missing ticks are gaps; pairs of samples that include a gap do not count.
    residual
        Measured minus modelled, shape (N,), in the output's unit; nan where unknown.
    lags
        Number of lags to test, at least 1.

    Raises
    ------
    UsageError
        There are fewer samples than four times the lags, the times lie on no grid, or residual or input is constant.
    """
    known = np.isfinite(residual)
    if np.count_nonzero(known) < 4 * max(lags, 1):
        raise UsageError(
            f"{recording.source}: {np.count_nonzero(known)} samples to test, need at least {4 * lags} for {lags} lags"
        )
    dt_s = recording.dt_s
    index = _grid_indices(recording, dt_s)
    e, u = (np.full(int(index[-1]) + 1, np.nan) for _ in range(2))
    e[index], u[index] = residual, recording.channel(input_column)
    mean = float(np.nanmean(e))
    e -= mean
    u -= np.nanmean(u)
    r_e, r_u = (np.array([_covariance(x, x, k) for k in range(lags + 1)]) for x in (e, u))
    if r_e[0] <= 0.0 or r_u[0] <= 0.0:
        raise UsageError(f"{recording.source}: {'the residual' if r_e[0] <= 0.0 else input_column} is constant")
    r_eu = np.array([_covariance(e, u, k) if k >= 0 else _covariance(u, e, -k) for k in range(-lags, lags + 1)])
    samples = int(np.count_nonzero(np.isfinite(e)))
    auto = r_e / r_e[0]
    spread = max(0.0, 1.0 + 2.0 * float(np.sum(auto[1:] * r_u[1:] / r_u[0])))
    return WhitenessTest(
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
    """Measured minus simulated output in free run, shape (N,), in the output's unit; nan in the start window.

    Parameters
    ----------
    recording
        Recording with the model's input and output.
    start_window_s
        Length of the start of the recording that estimates the initial state [s].
    sha256
        Hash of the recording's file.

    Raises
    ------
    RecordingError
        A column is missing.
    """
    measured = recording.channel(model.output.channel)
    window = int(np.searchsorted(recording.time_s, recording.time_s[0] + start_window_s))
    simulated, _ = simulate(model, recording, window, sha256)
    residual: Array = measured - simulated
    residual[:window] = np.nan
    return residual


def _grid_indices(recording: Recording, dt_s: float) -> NDArray[np.int64]:
    """Index of each sample on the time grid, shape (N,)."""
    index: NDArray[np.int64] = np.rint((recording.time_s - recording.time_s[0]) / dt_s).astype(np.int64)
    if (np.diff(index) < 1).any() or index[-1] >= MOST_SAMPLES:
        raise UsageError(
            f"{recording.source}: times lie on no grid of {dt_s:g} s, which correlations need; resample the recording"
        )
    return index


def _covariance(a: Array, b: Array, lag: int) -> float:
    """1/N sum a(t + lag) b(t) over pairs of known values, N the number of samples at which both are known."""
    products = a[lag:] * b[: b.size - lag]
    known = np.isfinite(products)
    samples = int(np.count_nonzero(np.isfinite(a) & np.isfinite(b)))
    return float(products[known].sum() / max(samples, 1))


def whiteness_as_dict(test: WhitenessTest, recording: Recording, model: str, unit: str) -> dict[str, Any]:
    """Return the test for JSON."""
    lags = test.auto.size - 1
    return {
        "schema": "piezod.residual/1",
        "recording": recording.source,
        "model": model,
        "unit": unit,
        "samples": test.samples,
        "mean": test.mean,
        "rms": test.rms,
        "lag_s": test.dt_s,
        "confidence": 0.99,
        "auto": {"lags": list(range(lags + 1)), "values": test.auto.tolist(), "bound": test.auto_bound},
        "cross": {"lags": list(range(-lags, lags + 1)), "values": test.cross.tolist(), "bound": test.cross_bound},
        "auto_outside": test.auto_outside,
        "cross_outside": test.cross_outside,
        "words": test.sentence,
    }


def whiteness_text(test: WhitenessTest, unit: str) -> str:
    """Format samples, residual, both correlations and the verdict as text."""
    middle = (test.cross.size - 1) // 2
    auto_lag = int(np.argmax(np.abs(test.auto[1:]))) + 1
    cross_index = int(np.argmax(np.abs(test.cross)))
    lags = test.auto.size - 1
    auto = _largest(test.auto[auto_lag], auto_lag, test.auto_bound, test.auto_outside, lags)
    cross = _largest(
        test.cross[cross_index], cross_index - middle, test.cross_bound, test.cross_outside, test.cross.size
    )
    lines = [
        f"{test.samples} samples, one lag {1e3 * test.dt_s:g} ms",
        f"residual: rms {test.rms:.4g} {unit}, mean {test.mean:+.4g} {unit}",
        f"autocorrelation: {auto}",
        f"with the input:  {cross}",
        test.sentence,
    ]
    return "\n".join(lines)


def _largest(value: float, lag: int, bound: float, outside: int, lags: int) -> str:
    return f"largest {value:+.3f} at lag {lag}, bound {bound:.4f}; {outside} of {lags} lags beyond it"


def write_whiteness_page(
    path: Path,
    test: WhitenessTest,
    recording: Recording,
    residual: Array,
    unit: str,
    step: NextStep | None = None,
) -> None:
    """Write the page: verdict, both correlations with their bounds, and the residual over time.

    Parameters
    ----------
    residual
        Measured minus modelled, shape (N,), in the output's unit.
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    lags = np.arange(test.auto.size, dtype=np.float64)
    both_signs = np.arange(test.cross.size, dtype=np.float64) - (test.cross.size - 1) // 2
    over_time = labelled_figure("Residual over time", "time [s]", f"residual [{unit_words(unit)}]", 240)
    shown_s = envelope_times(recording.time_s, POINTS)
    over_time.line(shown_s, envelope(residual, POINTS), color=ORANGE, legend_label="residual")
    auto = _stems("Autocorrelation of the residual", lags, test.auto, test.auto_bound)
    cross = _stems("Correlation of the residual with the input", both_signs, test.cross, test.cross_bound)
    note = (
        f"{test.samples} samples, one lag {1e3 * test.dt_s:g} ms; residual mean {test.mean:+.4g} {unit}. "
        "Shaded: the range of 99 % of the correlations if the residual is white and independent of the input, "
        "as in MATLAB. At positive lags the residual follows the input."
    )
    parts: list[Part] = [[auto, cross], f"<p class='dim'>{html.escape(note)}</p>", [finish_figure(over_time)]]
    write_page(path, "Residual", ("Whiteness of the residual", test.sentence), parts, step)


def _stems(title: str, lags: Array, values: Array, bound: float) -> figure:
    plot = labelled_figure(title, "lag [samples]", "correlation [1]", 300)
    plot.add_layout(BoxAnnotation(bottom=-bound, top=bound, fill_color=GREY, fill_alpha=0.25, line_color=None))
    plot.segment(lags, 0.0, lags, values, color=BLUE, line_width=2)
    plot.scatter(lags, values, color=BLUE, size=6, legend_label="correlation")
    return finish_figure(plot)
