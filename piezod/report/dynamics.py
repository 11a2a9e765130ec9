"""Spectrum of the residual of an identification with its tones, and response of the bench to a step."""

import html
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from bokeh.models import CustomJSTickFormatter
from bokeh.plotting import figure

from piezod.arrays import Array
from piezod.estimation.recordings.noise import Noise
from piezod.excitation import IDENTIFICATION
from piezod.identify.step_response import StepResponse, step_response
from piezod.report.diagnosis.figures.drawing import DECIMAL_TICKS
from piezod.report.diagnosis.residual.spectra import spectrum, windows_of
from piezod.report.figures.layout import finish_figure, labelled_figure
from piezod.report.page import Part
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED

MOST_MISSING = 0.05  # share of missing samples up to which a spectrum of the filled record is drawn
HEIGHT = 280  # [px]
FALSE_TONES = 0.01  # expected number of lines in noise alone, in the whole spectrum
SURROUNDINGS, OWN = 12, 2  # bins on each side whose median is the background; bins on each side of a Hann line
SKIRT = 0.05  # largest excess three bins from a line, as share of its own; a Hann line has 0.001, a hump most
OVERLAP = 1.056  # variance of a mean of half-overlapping Hann windows over that of independent ones (Welch 1967)
MOST_TONES = 5  # largest tones that a page names


@dataclass(frozen=True)
class Tone:
    """A line: frequency [Hz], amplitude of the sine [unit], density at its peak, and whether the input has it."""

    frequency_Hz: float
    amplitude: float
    density: float
    in_input: bool


def find_tones(frequency_Hz: Array, density: Array, input_density: Array, windows: int) -> list[Tone]:
    """The largest tones, at most `MOST_TONES`, in descending order of amplitude.

    A line stands above the median of its surroundings by more than noise does in one of a hundred spectra.

    Parameters
    ----------
    frequency_Hz, density, input_density
        Equally spaced frequencies, and densities of the residual and of the input [unit / sqrt(Hz)], shape (F,).
    windows
        Number of half-overlapping Hann windows over which the densities are averaged.
    """
    if density.size <= 2 * SURROUNDINGS + 1:
        return []
    power, step_Hz = density**2, frequency_Hz[1] - frequency_Hz[0]
    background, of_input = _background(power), _background(input_density**2)
    spread = OVERLAP / (9.0 * windows)  # 2 / (9 degrees of freedom), each window has two
    quantile = NormalDist().inv_cdf(1.0 - FALSE_TONES / density.size)
    above = (1.0 + quantile * np.sqrt(spread) / (1.0 - spread)) ** 3  # over the median; Wilson and Hilferty (1931)
    tones = []
    excess = power - background
    for k in range(SURROUNDINGS, density.size - OWN - 1):
        line = slice(k - OWN, k + OWN + 1)
        if power[k] <= above * background[k] or power[line].max() > power[k]:
            continue
        if max(excess[k - OWN - 1], excess[k + OWN + 1]) > SKIRT * excess[k]:
            continue
        area = float(power[line].sum() - (2 * OWN + 1) * background[k]) * step_Hz
        peak = k - OWN + int(np.argmax(input_density[line]))
        shared = abs(peak - k) < OWN and input_density[peak] ** 2 > above * of_input[peak]
        tones.append(
            Tone(float(frequency_Hz[k]), float(np.sqrt(2.0 * max(area, 0.0))), float(density[k]), bool(shared))
        )
    return sorted(tones, key=lambda tone: -tone.amplitude)[:MOST_TONES]


def dynamics(
    command: Array, measured: Array, modelled: Array, dt_s: float, unit: str, noise: Noise | None
) -> list[Part]:
    """Spectrum of the residual with its tones, and step response, with a sentence below each.

    Parameters
    ----------
    command, measured, modelled
        Input, measured output, nan where missing, and output of the model, shape (N,).
    dt_s
        Sample period [s].
    unit
        Unit of the output, in words of a page.
    noise
        Noise of the recording; None: it is estimated from second differences.
    """
    present = np.isfinite(measured)
    if np.mean(~present) > MOST_MISSING:
        return [f"<p class='dim'>No spectrum: {100.0 * np.mean(~present):.0f} % of the samples are missing.</p>"]
    residual = measured - modelled
    if not present.all():
        index = np.arange(residual.size)
        residual = np.interp(index, index[present], residual[present])
    frequency_Hz, density = spectrum(residual, dt_s)
    _, of_input = spectrum(command, dt_s)
    tones = find_tones(frequency_Hz, density, of_input, windows_of(residual.size))
    response = step_response(measured, modelled, dt_s)
    floor, noise_words = _floor(density, tones, noise, dt_s, unit)
    plots = [_spectrum_plot((frequency_Hz, density), tones, floor, unit)]
    shown = response is not None and response.is_shown
    if shown:
        assert response is not None
        plots.append(_step_plot(response))
    words = html.escape(f"{_tone_words(tones, unit)} {noise_words} {_step_words(response, dt_s)}")
    return [plots, f"<p class='dim'>{words}</p>"]


def _floor(density: Array, tones: list[Tone], noise: Noise | None, dt_s: float, unit: str) -> tuple[float, str]:
    """Density of white noise with the power of the noise without its tones [unit / sqrt(Hz)], and its origin."""
    if noise is None:
        floor = float(np.median(density[density.size // 2 :]))
        rms = floor / np.sqrt(2.0 * dt_s)
        return floor, f"The noise is {rms:.3g} {unit} rms, from the upper half of the spectrum."
    of_tones = 0.5 * sum(tone.amplitude**2 for tone in tones if not tone.in_input)
    rest = noise.rms**2 - of_tones
    words = f"The noise is {noise.rms:.3g} {unit} rms, seen in {noise.seen_in}"
    if not tones or rest <= 0.0:
        return float(noise.rms * np.sqrt(2.0 * dt_s)), f"{words}."
    return float(
        np.sqrt(2.0 * dt_s * rest)
    ), f"{words}; {np.sqrt(rest):.3g} {unit} without tones that the input does not have."


def _spectrum_plot(density: tuple[Array, Array], tones: list[Tone], floor: float, unit: str) -> figure:
    """Density of the residual over frequency, its tones, and the noise floor."""
    frequency_Hz, values = density
    plot = labelled_figure(
        "Spectrum of the residual", "frequency [Hz]", f"{unit} / √Hz", HEIGHT, x_axis_type="log", y_axis_type="log"
    )
    plot.xaxis.formatter = plot.yaxis.formatter = CustomJSTickFormatter(code=DECIMAL_TICKS)
    plot.line(frequency_Hz, values, color=ORANGE, legend_label="residual")
    plot.line(frequency_Hz[[0, -1]], [floor, floor], color=GREEN, line_dash="dashed", legend_label="noise")
    for in_input, colour, label in ((True, BLUE, "tone of the input"), (False, RED, "other tone")):
        marked = [tone for tone in tones if tone.in_input is in_input]
        if marked:
            x, y = [tone.frequency_Hz for tone in marked], [tone.density for tone in marked]
            plot.scatter(x, y, size=9, color=colour, fill_alpha=0.3, legend_label=label)
    return finish_figure(plot)


def _step_plot(response: StepResponse) -> figure:
    """Share of a step over time, its band, and the static model."""
    plot = labelled_figure(
        "Response to a step of the modelled output", "time since the step [s]", "share of the step", HEIGHT
    )
    lag_s, low, high = response.lag_s, response.response - response.band, response.response + response.band
    plot.varea(lag_s, low, high, color=ORANGE, fill_alpha=0.3, legend_label="95 % band")
    plot.step(
        [lag_s[0], 0.0, lag_s[-1]], [0.0, 1.0, 1.0], mode="after", color=BLUE, legend_label="static model", line_width=1
    )
    plot.line(lag_s, response.response, color=GREY, line_width=2, legend_label="measured")
    plot.scatter(lag_s, response.response, color=GREY, size=5)
    return finish_figure(plot)


def _tone_words(tones: list[Tone], unit: str) -> str:
    if not tones:
        return "The spectrum has no tones."
    texts = {
        shared: ", ".join(f"{t.frequency_Hz:.4g} Hz ({t.amplitude:.3g} {unit})" for t in tones if t.in_input is shared)
        for shared in (False, True)
    }
    outside = f"Tones that the input does not have, as of hum or vibration: {texts[False]}." if texts[False] else ""
    inside = f"Tones that the input has too, errors of the model: {texts[True]}." if texts[True] else ""
    return f"{outside} {inside}".strip()


def _step_words(response: StepResponse | None, dt_s: float) -> str:
    """The response in a sentence, or the recording that determines one."""
    if response is None or not response.is_shown:
        return (
            "This record does not determine a step response: its input holds too little that is fast. Record with "
            f"--excitation {IDENTIFICATION}. If this record is already one, raise --frequency."
        )
    widest = f"the band is ± {100.0 * response.band.max():.0f} % at most"
    if response.rise_s is None:
        return f"The output follows a step of the model within one sample of {1e3 * dt_s:.3g} ms; {widest}."
    return f"90 % of the response is reached after {1e3 * response.rise_s:.3g} ms; {widest}."


def _background(power: Array) -> Array:
    """Median of the bins around each bin, without its own line, shape (F,)."""
    half = SURROUNDINGS
    padded = np.pad(power, half, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    outside = np.abs(np.arange(-half, half + 1)) > OWN
    background: Array = np.median(around[:, outside], axis=1)
    return background
