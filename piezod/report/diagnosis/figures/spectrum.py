"""Figures of the residuals' spectrum, and of their power over time and frequency."""

from collections.abc import Iterable, Sequence

import numpy as np
from bokeh.models import BasicTicker, ColumnDataSource, CustomJSTickFormatter, FixedTicker, LinearColorMapper, Range1d
from bokeh.models.annotations import ColorBar
from bokeh.models.glyphs import Image
from bokeh.palettes import interp_palette
from bokeh.plotting import figure

from piezod.arrays import Array
from piezod.diagnose.findings import Place
from piezod.report.diagnosis.figures.drawing import (
    DECIMAL_TICKS,
    EXTENDED,
    GIVEN,
    Columns,
    column_source,
    draw_curve,
    finish,
    places_on,
    shade,
)
from piezod.report.diagnosis.residual.spectra import PowerMap
from piezod.report.figures.layout import labelled_figure
from piezod.report.style import GREEN

POWER_COLOURS = ("#ffffff", "#fdd9a0", "#e8801a", "#a33a00", "#2b0c00")  # darker with power, readable without colour
SMALLEST_RANGE_DB, LARGEST_RANGE_DB = 20.0, 60.0


def spectrum_figure(
    spectra: tuple[Array, Array, Array], floor: float, places: Sequence[Place], unit: str, extended: str
) -> tuple[list[figure], Columns]:
    """Amplitude density of the residuals of both models, and of the noise.

    Parameters
    ----------
    spectra
        Frequencies [Hz], densities of given and extended model [output unit / sqrt(Hz)], each shape (F,).
    floor
        Density of white noise with the power of the noise floor [output unit / sqrt(Hz)].
    places
        Places in which the given model is wrong; those in frequency are shaded.
    extended
        Name of the model after the diagnosis.
    """
    frequency_Hz, before, after = spectra
    columns = {"frequency_Hz": frequency_Hz, "before": before, "after": after}
    source = column_source(columns)
    plot = labelled_figure(
        "Spectrum of the residual",
        "frequency [Hz]",
        f"{unit} / √Hz",
        280,
        x_axis_type="log",
        y_axis_type="log",
        tools="pan,wheel_zoom,box_zoom,reset,save",
        active_drag="box_zoom",
    )
    plot.xaxis.formatter = CustomJSTickFormatter(code=DECIMAL_TICKS)
    plot.yaxis.formatter = CustomJSTickFormatter(code=DECIMAL_TICKS)
    draw_curve(plot, source, "before", "given model", GIVEN, x="frequency_Hz")
    draw_curve(plot, source, "after", extended, EXTENDED, x="frequency_Hz")
    ends_Hz = [frequency_Hz[0], frequency_Hz[-1]]
    plot.line(ends_Hz, [floor, floor], color=GREEN, line_dash="dashed", legend_label="noise floor")
    shade(plot, places_on(places, "frequency_Hz"))
    return [finish(plot)], columns


def power_scale(maps: Iterable[PowerMap]) -> LinearColorMapper:
    """Colour scale for all maps, from the noise floor to the highest power.

    Parameters
    ----------
    maps
        Power maps, at least one.
    """
    highest = max(float(np.quantile(power.level_dB, 0.999)) for power in maps)
    high = float(np.clip(10.0 * np.ceil(highest / 10.0), SMALLEST_RANGE_DB, LARGEST_RANGE_DB))
    return LinearColorMapper(palette=interp_palette(POWER_COLOURS, 128), low=0.0, high=high)


def map_figure(power: PowerMap, start_s: float, title: str, scale: LinearColorMapper) -> figure:
    """Power over time and frequency, in decibels above the noise floor.

    Parameters
    ----------
    start_s
        Time of its first sample [s].
    """
    low, high = np.log10(power.frequency_Hz[0]), np.log10(power.frequency_Hz[-1])
    ends_s = start_s + power.time_s[[0, -1]]
    plot = labelled_figure(
        title,
        "time [s]",
        "frequency [Hz]",
        280,
        x_range=Range1d(start=ends_s[0], end=ends_s[1]),
        y_range=Range1d(start=low, end=high),
        tools="box_zoom,reset,save",
    )
    level = np.clip(np.round(power.level_dB), -30, 120).astype(np.int8)
    image = Image(image="level", x=ends_s[0], y=low, dw=ends_s[1] - ends_s[0], dh=high - low, color_mapper=scale)
    plot.add_glyph(ColumnDataSource({"level": [level]}), image)
    ticks = [decade + step for decade in range(-5, 6) for step in np.log10((1.0, 3.0))]
    plot.yaxis.ticker = FixedTicker(ticks=[float(tick) for tick in ticks if low <= tick <= high])
    plot.yaxis.formatter = CustomJSTickFormatter(code="return String(Number(Math.pow(10, tick).toPrecision(1)))")
    plot.add_layout(ColorBar(color_mapper=scale, title="dB", width=12, ticker=BasicTicker()), "right")
    return finish(plot)
