"""The data of every figure of a page as CSV beside it, for other programs and for those who want the numbers."""

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

MOST_NAME = 50  # signs of a file's name

Cells = list[str]


def write_figure_data(page: Path, figures: Mapping[str, Model]) -> Path | None:
    """Write one CSV a figure into the folder beside a page; what an earlier page left there goes.

    Parameters
    ----------
    page
        Such as `report.html`; its folder is `report.data`.
    figures
        In the order of the page.

    Returns
    -------
    Path or None
        The folder; None where no figure has data.

    Raises
    ------
    OSError
        It cannot be written.
    """
    folder = page.with_suffix(".data")
    texts = [(plot, text) for plot in figures.values() if isinstance(plot, Plot) and (text := figure_csv(plot))]
    for old in folder.glob("[0-9][0-9]-*.csv"):
        old.unlink()
    if not texts:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    for number, (plot, text) in enumerate(texts, 1):
        (folder / f"{number:02d}-{_slug(plot)}.csv").write_text(text, encoding="utf-8")
    return folder


def figure_csv(plot: Plot) -> str:
    """What a figure draws, a row a point: the curve's name, then its coordinates under the words of the axes.

    Parameters
    ----------
    plot
        Curves, points, bars, segments and maps; a map is a row a cell.

    Returns
    -------
    str
        CSV with one header; empty where nothing is drawn.
    """
    axes = {"x": _label(plot.below, "x"), "y": _label(plot.left, "y")}
    names = _curve_names(plot)
    header = ["curve"]
    rows: list[dict[str, str]] = []
    for number, renderer in enumerate(one for one in plot.renderers if isinstance(one, GlyphRenderer)):
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
    """Columns of one glyph, of equal length."""
    source, glyph = renderer.data_source, renderer.glyph
    if not isinstance(source, ColumnDataSource):
        return {}
    if isinstance(glyph, Image):
        return _cells_of(glyph, source, axes)
    places = {_field(glyph, place): axes[place] for place in ("x", "y")}
    columns = {places.get(key, key): np.asarray(values) for key, values in source.data.items()}
    sizes = {values.size for values in columns.values()}
    return columns if len(sizes) == 1 and all(values.ndim == 1 for values in columns.values()) else {}


def _cells_of(glyph: Image, source: ColumnDataSource, axes: Mapping[str, str]) -> dict[str, np.ndarray]:
    """A map as its cells: their centres and their value."""
    level = np.asarray(source.data[_field(glyph, "image")][0])
    rows, columns = level.shape
    x, y, width, height = (float(_value(glyph, name)) for name in ("x", "y", "dw", "dh"))
    at_x = x + width * (np.arange(columns) + 0.5) / columns
    at_y = y + height * (np.arange(rows) + 0.5) / rows
    return {axes["x"]: np.tile(at_x, rows), axes["y"]: np.repeat(at_y, columns), "value": level.ravel()}


def _field(glyph: Model, name: str) -> str:
    """Name of the column that a property takes its values from."""
    said = getattr(glyph, name, None)
    return str(getattr(said, "field", said))


def _value(glyph: Model, name: str) -> float:
    said = getattr(glyph, name)
    return float(getattr(said, "value", said))


def _curve_names(plot: Plot) -> dict[str, str]:
    """Words of the legend by the renderer that they stand for."""
    legends = [one for side in ("above", "below", "left", "right", "center") for one in getattr(plot, side)]
    found = {}
    for legend in legends:
        for item in getattr(legend, "items", ()):
            for renderer in item.renderers:
                found[renderer.id] = str(getattr(item.label, "value", item.label))
    return found


def _label(sides: Iterable[Model], otherwise: str) -> str:
    for axis in sides:
        if words := getattr(axis, "axis_label", None):
            return str(words)
    return otherwise


def _slug(plot: Plot) -> str:
    title = str(getattr(plot.title, "text", "") or "figure")
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:MOST_NAME].rstrip("-") or "figure"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    return str(value)
