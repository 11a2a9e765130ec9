"""HTML that all pages share. A page is one self-contained file for a screen, a telephone or A4 paper."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

from bokeh.document import Document
from bokeh.embed import components
from bokeh.model import Model
from bokeh.resources import Resources

from piezod.diagnose.verdict.words import unit_words
from piezod.errors import ConfigurationError
from piezod.report.figures.data_files import write_figure_data
from piezod.report.next_step import NextStep
from piezod.report.style import DATA_NOTE, PAGE_CSS, PAGE_SCRIPT, PAGE_TEMPLATE
from piezod.runtime.files import written

Group = tuple[str, int]  # heading of neighbouring columns, and their number
Part = str | Sequence[Model]  # HTML, or figures side by side


def axis_label(channel: str) -> str:
    """Label of an axis from the name of a column: `displacement_um` becomes displacement [µm].

    Parameters
    ----------
    channel
        Name of the column, with its unit last.
    """
    name, _, unit = channel.rpartition("_")
    return f"{name.replace('_', ' ')} [{unit_words(unit)}]" if name else channel


def table_html(header: Sequence[str], rows: Sequence[Sequence[str]], groups: Sequence[Group] = ()) -> str:
    """Table of numbers with escaped cells. A table wider than the screen scrolls.

    Parameters
    ----------
    groups
        Row above the header: headings, and the number of columns that each spans.
    """
    above = "".join(f"<th class='group' colspan='{span}'>{html.escape(heading)}</th>" for heading, span in groups)
    head = "".join(f"<th>{html.escape(cell)}</th>" if cell else "<td></td>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    lines = f"<tr>{above}</tr><tr>{head}</tr>" if groups else f"<tr>{head}</tr>"
    scrolls = "<div class='scroll' role='group' aria-label='table' tabindex='0'>"  # by the arrow keys too
    return f"{scrolls}<table class='numbers'><thead>{lines}</thead><tbody>{body}</tbody></table></div>"


def fold_html(heading: str, inside: str) -> str:
    """A section that a narrow screen shows folded, and a wide one or paper open; empty without content.

    Parameters
    ----------
    heading
        Heading as plain text.
    inside
        HTML of the section.
    """
    if not inside:
        return ""
    return f"<details class='fold' open><summary><h2>{html.escape(heading)}</h2></summary>{inside}</details>"


def next_step_html(step: NextStep | None) -> str:
    """Box with the next step and its lines to paste; empty for None.

    Parameters
    ----------
    step
        Next step after the command that wrote the page.
    """
    if step is None:
        return ""
    lines = "".join(
        f"<p class='dim'>{heading}</p><pre tabindex='0' role='group' aria-label='{heading}'>"
        f"<code>{html.escape(chr(10).join(texts))}</code></pre>"
        for heading, texts in (("In the bench file", step.bench_lines), ("To paste", step.commands))
        if texts
    )
    words = html.escape(f"{step.words[:1].upper()}{step.words[1:]}.")
    return f"<section class='next' aria-label='next step'><p><b>Next:</b> {words}</p>{lines}</section>"


def placeholder(name: str) -> str:
    """Comment that `write_html` replaces by the figure of that name."""
    return f"<!--{name}-->"


def write_page(
    path: Path, title: str, head: tuple[str, str], parts: Sequence[Part], step: NextStep | None = None
) -> None:
    """Write a self-contained page atomically, and the data of its figures as CSV files next to it.

    Parameters
    ----------
    title
        Title of the browser window.
    head
        Heading and verdict at the top, as plain text.
    parts
        HTML and rows of figures below, from top to bottom; more than two figures stand in rows of three.
    step
        Next step after the command that wrote the page, below the verdict; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    figures: dict[str, Model] = {}
    body = [_head_html(*head), next_step_html(step)]
    for number, part in enumerate(part for part in parts if part):
        if isinstance(part, str):
            body.append(part)
            continue
        names = [f"figure_{number}_{column}" for column in range(len(part))]
        figures |= dict(zip(names, part, strict=True))
        inside = "".join(f"<figure>{placeholder(name)}</figure>" for name in names)
        columns = {1: "alone", 2: "pair"}.get(len(names), "three")
        body.append(f"<div class='{columns}'>{inside}</div>")
    try:
        folder = write_figure_data(path, figures)
    except OSError as error:
        raise ConfigurationError(f"{path}: the figures' data cannot be written: {error.strerror}") from error
    if folder is not None:
        body.append(DATA_NOTE.format(folder=html.escape(folder.name)))
    write_html(path, title, "".join(body), figures)


def write_html(path: Path, title: str, body: str, figures: Mapping[str, Model]) -> None:
    """Write a self-contained page.

    Parameters
    ----------
    title
        Title of the browser window.
    body
        HTML with a `placeholder` for each figure.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    document = Document()
    with document.models.freeze():  # without it each addition visits all models
        for plot in figures.values():
            document.add_root(plot)
    script, divs = components(dict(figures)) if figures else ("", {})
    for name, div in divs.items():
        body = body.replace(placeholder(name), div)
    library = Resources(mode="inline", components=["bokeh"]).render_js()
    parts = {"style": PAGE_CSS, "library": library, "script": script, "own": PAGE_SCRIPT}
    written(path, PAGE_TEMPLATE.format(title=html.escape(title), body=body, **parts), parents=True)


def _head_html(heading: str, verdict: str) -> str:
    return f"<header><h1>{html.escape(heading)}</h1><p class='lead'>{html.escape(verdict)}</p></header>"
