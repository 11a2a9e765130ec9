"""The data of the figures of a page, as CSV files in a folder next to the page."""

import csv
import io
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.model import Model
from bokeh.models import ColumnDataSource
from bokeh.models.glyphs import Image
from bokeh.models.plots import Plot
from bokeh.models.renderers import GlyphRenderer

from piezod.runtime.files import written

MOST_NAME = 50  # characters of a file's name

Cells = list[str]


def write_figure_data(page: Path, figures: Mapping[str, Model]) -> Path | None:
    """Write one CSV file for each figure, and delete the files of an earlier version of the page.

    Parameters
    ----------
    page
        File of the page. The folder of `report.html` is `report.data`.
    figures
        Figures by name, in the order of the page.

    Returns
    -------
    Path or None
        The folder; None if no figure has data.

    Raises
    ------
    OSError
        A file cannot be written.
    """
    folder = page.with_suffix(".data")
    texts = [(plot, text) for plot in figures.values() if isinstance(plot, Plot) and (text := figure_csv(plot))]
    for old in folder.glob("[0-9][0-9]-*.csv"):
        if _is_own(old):
            old.unlink()
    if not texts:
        return None
    for number, (plot, text) in enumerate(texts, 1):
        written(folder / f"{number:02d}-{_slug(plot)}.csv", text, parents=True)
    return folder


def _is_own(path: Path) -> bool:
    """Whether `figure_csv` made a file; a file of somebody else stays."""
    with path.open("rb") as file:
        return file.read(6) == b"curve,"


def figure_csv(plot: Plot) -> str:
    """Format the data of a figure as CSV: one row for each point, with the curve's name and its coordinates.

    Parameters
    ----------
    plot
        Figure with curves, points, bars, segments or maps. A map has one row for each cell.

    Returns
    -------
    str
        CSV with one header row. The labels of the axes name the coordinates. Empty without curves.
    """
    axes = {"x": _label(plot.below, "x"), "y": _label(plot.left, "y")}
    names = _curve_names(plot)
    header = ["curve"]
    rows: list[dict[str, str]] = []
    glyphs = [renderer for renderer in plot.renderers if isinstance(renderer, GlyphRenderer)]
    for number, renderer in enumerate(glyphs):
        name = names.get(renderer.id) or renderer.name or f"curve {number + 1}"
        columns = {key: values for key, values in _columns(renderer, axes).items() if values.size}
        header += [key for key in columns if key not in header]
        points = zip(*(values.tolist() for values in columns.values()), strict=True)
        rows += [{"curve": name} | dict(zip(columns, map(_cell, cells), strict=True)) for cells in points]
    if not rows:
        return ""
    text = io.StringIO()
    writer = csv.DictWriter(text, header, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _columns(renderer: "GlyphRenderer[Any]", axes: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Columns of a glyph; empty if their lengths differ."""
    source, glyph = renderer.data_source, renderer.glyph
    if not isinstance(source, ColumnDataSource):
        return {}
    if isinstance(glyph, Image):
        return _map_columns(glyph, source, axes)
    labels = {_field(glyph, coordinate): axes[coordinate] for coordinate in ("x", "y")}
    columns = {labels.get(key, key): np.asarray(values) for key, values in source.data.items()}
    sizes = {values.size for values in columns.values()}
    return columns if len(sizes) == 1 and all(values.ndim == 1 for values in columns.values()) else {}


def _map_columns(glyph: Image, source: ColumnDataSource, axes: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Centre and value of each cell of a map."""
    level = np.asarray(source.data[_field(glyph, "image")][0])
    rows, columns = level.shape
    x, y, width, height = (float(_value(glyph, name)) for name in ("x", "y", "dw", "dh"))
    at_x = x + width * (np.arange(columns) + 0.5) / columns
    at_y = y + height * (np.arange(rows) + 0.5) / rows
    return {axes["x"]: np.tile(at_x, rows), axes["y"]: np.repeat(at_y, columns), "value": level.ravel()}


def _field(glyph: Model, name: str) -> str:
    """Name of the column that holds the values of a property."""
    value = getattr(glyph, name, None)
    return str(getattr(value, "field", value))


def _value(glyph: Model, name: str) -> float:
    value = getattr(glyph, name)
    return float(getattr(value, "value", value))


def _curve_names(plot: Plot) -> dict[str, str]:
    """Labels of the legend by the identifier of their renderer."""
    panels = [panel for side in ("above", "below", "left", "right", "center") for panel in getattr(plot, side)]
    names = {}
    for panel in panels:
        for item in getattr(panel, "items", ()):
            for renderer in item.renderers:
                names[renderer.id] = str(getattr(item.label, "value", item.label))
    return names


def _label(panels: Iterable[Model], default: str) -> str:
    for panel in panels:
        if label := getattr(panel, "axis_label", None):
            return str(label)
    return default


def _slug(plot: Plot) -> str:
    title = str(getattr(plot.title, "text", "") or "figure")
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:MOST_NAME].rstrip("-") or "figure"


def _cell(value: object) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)
