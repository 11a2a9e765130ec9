"""Figure of an unnamed law: its part of the reading over the first driver, with a curve for values of the second."""

import numpy as np
from bokeh.plotting import figure

from piezod.arrays import Array
from piezod.diagnose.verdict.words import rounded
from piezod.model.unnamed_law import Axis, UnnamedLaw, node_values
from piezod.report.diagnosis.figures.drawing import column_source, draw_curve, finish, new_figure
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED

COLOURS = (BLUE, ORANGE, GREEN, RED, GREY)
LABELS = {
    "command": "command [{0}]",
    "rate": "rate of the command [{0}/s]",
    "direction": "direction of the command",
    "way": "way since the last reversal [{0}]",
    "stroke": "last stroke [{0}]",
    "reading": "expected reading [{1}]",
    "reading_rate": "rate of the expected reading [{1}/s]",
}


def law_figure(law: UnnamedLaw, units: tuple[str, str]) -> tuple[figure, dict[str, Array]]:
    """Steady values of a law, and its columns.

    Parameters
    ----------
    units
        Units of command and output.
    """
    if law.linear:
        return _response_figure(law, units)
    first, *more = law.drivers
    steady = np.sum(law.tables, axis=0).reshape(first.nodes, -1)
    columns: dict[str, Array] = {first.driver: node_values(first)}
    plot = new_figure("", LABELS[first.driver].format(*units), "gain [1]" if law.gain else f"added [{units[1]}]", 300)
    chosen = np.unique(np.linspace(0, steady.shape[1] - 1, min(len(COLOURS), steady.shape[1])).astype(int))
    names = _names(more[0], units) if more else ["law"]
    for k in chosen.tolist():
        columns[names[k]] = steady[:, k]
    source = column_source(columns)
    for colour, name in zip(COLOURS, list(columns)[1:], strict=False):
        draw_curve(plot, source, name, name, colour, x=first.driver, width=2.0)
    return finish(plot), columns


def _response_figure(law: UnnamedLaw, units: tuple[str, str]) -> tuple[figure, dict[str, Array]]:
    """Gain of linear dynamics over frequency, and its columns."""
    corners_Hz = [1.0 / (2.0 * np.pi * one) for one in law.memories_s if one > 0.0]
    corners_Hz += [mode.frequency_Hz for mode in law.modes]
    around_Hz = [mode.frequency_Hz * (1.0 + mode.damping_ratio * np.linspace(-5.0, 5.0, 41)) for mode in law.modes]
    wide_Hz = np.geomspace(0.1 * min(corners_Hz), 10.0 * max(corners_Hz), 200)
    frequency_Hz = np.unique(np.concatenate([wide_Hz, *around_Hz]))
    dt_s = law.smoothing_s  # the sample period of the recordings that it was fitted to
    frequency_Hz = frequency_Hz[(frequency_Hz >= wide_Hz[0]) & (frequency_Hz <= 0.5 / dt_s)]
    columns: dict[str, Array] = {"frequency": frequency_Hz, "gain": np.abs(law.response(frequency_Hz, dt_s))}
    unit = f"{units[1]}/{units[0]}" if law.drivers[0].driver == "command" else "1"
    plot = new_figure("", "frequency [Hz]", f"gain [{unit}]", 300, x_axis="log")
    draw_curve(plot, column_source(columns), "gain", "gain", BLUE, x="frequency", width=2.0)
    return finish(plot), columns


def _names(axis: Axis, units: tuple[str, str]) -> list[str]:
    """Names of the curves at every node of the second driver."""
    if axis.driver == "direction":
        return ["falling", "rising"]
    label, _, unit = LABELS[axis.driver].format(*units).rstrip("]").partition(" [")
    return [f"{label} {rounded(float(value))} {unit}" for value in node_values(axis)]
