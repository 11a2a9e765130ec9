"""The frame that every page shares: self-contained, works offline, on a telephone and on A4."""

import html
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from bokeh.document import Document
from bokeh.embed import components
from bokeh.model import Model
from bokeh.resources import Resources

from piezod.diagnose.words import unit_words
from piezod.errors import ConfigurationError
from piezod.report.figures.data_files import write_figure_data
from piezod.report.style import DATA_NOTE, PAGE, SCRIPT, STYLE

Group = tuple[str, int]  # words above neighbouring columns, and how many
Part = str | Sequence[Model]  # HTML, or figures beside each other


def axis_label(channel: str) -> str:
    """A column's name as an axis has it: `displacement_um` is displacement [µm]."""
    name, _, unit = channel.rpartition("_")
    return f"{name.replace('_', ' ')} [{unit_words(unit)}]" if name else channel


def table_html(header: Sequence[str], rows: Sequence[Sequence[str]], groups: Sequence[Group] = ()) -> str:
    """A table of numbers, every cell escaped; one wider than the screen scrolls.

    Parameters
    ----------
    header
        Names of the columns.
    rows
        Cells.
    groups
        A line above the header: words, and over how many columns.
    """
    above = "".join(f"<th class='group' colspan='{span}'>{html.escape(words)}</th>" for words, span in groups)
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    lines = f"<tr>{above}</tr><tr>{head}</tr>" if groups else f"<tr>{head}</tr>"
    return f"<div class='scroll'><table class='numbers'><thead>{lines}</thead><tbody>{body}</tbody></table></div>"


def head_html(title: str, words: str) -> str:
    """The head line and the verdict below it."""
    return f"<header><h1>{html.escape(title)}</h1><p class='lead'>{html.escape(words)}</p></header>"


def slot(name: str) -> str:
    """Where a figure goes."""
    return f"<!--{name}-->"


def write_page(path: Path, title: str, parts: Sequence[Part]) -> None:
    """Write one self-contained page, whole or not at all, and the data of its figures as CSV beside it.

    Parameters
    ----------
    path
        The page.
    title
        Of the window.
    parts
        One below the other.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    figures: dict[str, Model] = {}
    body = []
    for number, part in enumerate(parts):
        if isinstance(part, str):
            body.append(part)
            continue
        names = [f"figure_{number}_{place}" for place in range(len(part))]
        figures |= dict(zip(names, part, strict=True))
        inside = "".join(f"<figure>{slot(name)}</figure>" for name in names)
        body.append(f"<div class='{'pair' if len(names) > 1 else 'alone'}'>{inside}</div>")
    try:
        folder = write_figure_data(path, figures)
    except OSError as error:
        raise ConfigurationError(f"{path}: the figures' data cannot be written: {error.strerror}") from error
    if folder is not None:
        body.append(DATA_NOTE.format(folder=html.escape(folder.name)))
    write_html(path, title, "".join(body), figures)


def write_html(path: Path, title: str, body: str, figures: Mapping[str, Model]) -> None:
    """Write a page whose body has a `slot` for every figure.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    document = Document()
    with document.models.freeze():  # adding them one by one walks through all of them each time
        for one in figures.values():
            document.add_root(one)
    script, divs = components(dict(figures)) if figures else ("", {})
    for name, div in divs.items():
        body = body.replace(slot(name), div)
    library = Resources(mode="inline", components=["bokeh"]).render_js()
    parts = {"style": STYLE, "library": library, "script": script, "own": SCRIPT}
    write_text(path, PAGE.format(title=html.escape(title), body=body, **parts))


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all; its folder is made.

    Raises
    ------
    ConfigurationError
        It cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error
