"""Text and page of a comparison of two models, parameter by parameter."""

import html
from pathlib import Path

from piezod.history.changes import ParameterChange
from piezod.history.comparison import ModelComparison
from piezod.history.words import interval, wording_of
from piezod.report.page import Part, head_html, table_html, write_page
from piezod.report.text_table import text_table

NONE = "-"


def model_comparison_text(comparison: ModelComparison) -> str:
    """Table of the parameters, the verdict, and notes."""
    return "\n".join(
        [
            *text_table(model_comparison_rows(comparison)),
            comparison.verdict,
            *(f"note: {note}" for note in comparison.notes),
        ]
    )


def model_comparison_rows(comparison: ModelComparison) -> list[list[str]]:
    """Table with a row for each parameter: values in both models, z, and whether it differs."""
    header = ["parameter", *(path.name for path in comparison.paths), "z", ""]
    return [header, *(_row(parameter, comparison) for parameter in comparison.parameters)]


def write_model_comparison_page(path: Path, comparison: ModelComparison) -> None:
    """Write the page: verdict, table, and notes.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    words, rows = comparison.verdict, model_comparison_rows(comparison)
    first, second = comparison.paths
    note = "z: difference over its standard error, from the 95 % intervals."
    notes = "".join(f"<li>{html.escape(text)}</li>" for text in (note, *comparison.notes))
    parts: list[Part] = [
        head_html(f"Comparison of {first.name} and {second.name}", f"{words[0].upper()}{words[1:]}."),
        table_html(rows[0], rows[1:]),
        f"<h2>Notes</h2><ul>{notes}</ul>",
    ]
    write_page(path, "Comparison", parts)


def _row(parameter: ParameterChange, comparison: ModelComparison) -> list[str]:
    values = zip((parameter.before, parameter.after), comparison.models, strict=True)
    cells = []
    for value, model in values:
        middle, ends = (NONE, "") if value is None else interval(parameter.key, value, wording_of(model))
        cells.append(f"{middle} ({ends})" if ends else middle)
    z = NONE if parameter.z is None else f"{parameter.z:+.1f}"
    return [parameter.heading, *cells, z, "differs" if parameter.changed else "agrees"]
