"""Figures of the residuals over their drivers and over the age of the command's past."""

from collections.abc import Sequence

from bokeh.plotting import figure

from piezod.diagnose.findings import Place
from piezod.report.diagnosis.figures.drawing import (
    EXTENDED,
    GIVEN,
    Axis,
    Columns,
    clipped,
    column_source,
    draw_band,
    draw_curve,
    finish,
    new_figure,
    places_on,
    shade,
)
from piezod.report.diagnosis.residual.views import BinnedResidual, Memory, View


def driver_figure(view: View, places: Sequence[Place], unit: str, extended: str) -> tuple[list[figure], Columns]:
    """Mean and standard deviation of the residuals over one driver.

    Parameters
    ----------
    places
        Places in which the given model is wrong; those on the driver are shaded.
    extended
        Name of the model after the diagnosis.
    """
    driver = view.driver
    columns = {driver.name: view.x, "readings": view.count, **_columns("before", view.before)}
    columns |= _columns("after", view.after)
    source = column_source({**columns, **_bounds("before", view.before), **_bounds("after", view.after)})
    scale: Axis = "log" if driver.logarithmic else "linear"
    plot = new_figure("", driver.label, f"residual [{unit}]", 250, x_axis=scale)
    for name, label, colour in (("before", "given model", GIVEN), ("after", extended, EXTENDED)):
        draw_band(plot, source, driver.name, name, colour)
        if driver.directions:
            draw_curve(plot, source, f"{name}_rising", label, colour, x=driver.name, width=2)
            draw_curve(plot, source, f"{name}_falling", label, colour, x=driver.name, width=2, dash="dashed")
        else:
            draw_curve(plot, source, f"{name}_mean", label, colour, x=driver.name, width=2)
    shaded = places_on(places, driver.axis)
    if driver.axis == "rate_V_per_s":  # places give the magnitude of the rate
        shaded += [Place(place.axis, -place.high, -place.low) for place in shaded]
    shade(plot, clipped(shaded, view.x))
    return [finish(plot)], columns


def memory_figure(memory: Memory, places: Sequence[Place], extended: str) -> tuple[list[figure], Columns]:
    """Correlation of the residuals with the command's past, over the age of that past.

    Parameters
    ----------
    places
        Places in which the given model is wrong; those in the command's past are shaded.
    extended
        Name of the model after the diagnosis.
    """
    columns = {"age_s": memory.age_s, "before": memory.before, "after": memory.after}
    source = column_source(columns)
    plot = new_figure("", "memory: age of the command's past [s]", "correlation", 250, x_axis="log")
    draw_curve(plot, source, "before", "given model", GIVEN, x="age_s", width=2)
    draw_curve(plot, source, "after", extended, EXTENDED, x="age_s", width=2)
    shade(plot, places_on(places, "history_s"))
    return [finish(plot)], columns


def _columns(name: str, residual: BinnedResidual) -> Columns:
    return {
        f"{name}_mean": residual.mean,
        f"{name}_standard_deviation": residual.standard_deviation,
        f"{name}_rising": residual.rising,
        f"{name}_falling": residual.falling,
    }


def _bounds(name: str, residual: BinnedResidual) -> Columns:
    return {
        f"{name}_low": residual.mean - residual.standard_deviation,
        f"{name}_high": residual.mean + residual.standard_deviation,
    }
