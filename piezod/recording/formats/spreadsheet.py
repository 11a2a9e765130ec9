"""Recordings in a workbook of Excel or LibreOffice (.xlsx, .xls, .ods): read only.

The first sheet that holds a table of numbers is read as the text that the spreadsheet itself would export. So names,
units, dates and missing columns are understood in the same way. Library: python-calamine.
"""

import datetime as dt
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library
from piezod.recording.formats.stream import RecordingStream
from piezod.recording.formats.text import open_text
from piezod.recording.formats.text_layout import TextOptions, find_layout
from piezod.recording.recording import Recording

SEPARATOR = "\t"
NO_TABLE = "holds no table of numbers"


@contextmanager
def open_spreadsheet(path: Path, options: TextOptions = TextOptions()) -> Iterator[RecordingStream]:  # noqa: B008
    """Open a workbook.

    Parameters
    ----------
    path
        The workbook.
    options
        What the user says about it; `decimal` is not needed.

    Raises
    ------
    RecordingError
        No sheet holds a table of numbers, python-calamine is not installed, or as for `open_text`.
    """
    library = import_library("python_calamine", "xlsx", path)
    options = replace(options, decimal=".")
    with library.CalamineWorkbook.from_path(str(path)) as book, tempfile.TemporaryDirectory() as folder:
        exported = Path(folder) / "sheet.tsv"
        name = _export_table(book, exported, options, path)
        with _named(exported, path, name), open_text(exported, options) as stream:
            understood = stream.metadata["understood"].split(", ", 3)[3]  # behind separator, decimal mark and encoding
            yield replace(
                stream, path=path, metadata={**stream.metadata, "understood": f"sheet {name!r}, {understood}"}
            )


def _export_table(book: Any, exported: Path, options: TextOptions, path: Path) -> str:  # noqa: ANN401  # untyped library
    """Write the first sheet with a table of numbers as text; return its name."""
    for name in book.sheet_names:
        with exported.open("w", encoding="utf-8") as file:
            for row in book.get_sheet_by_name(name).iter_rows():
                file.write(SEPARATOR.join(map(_text, row)) + "\n")
        with _named(exported, path, name):
            try:
                find_layout(exported, options)
            except RecordingError as error:
                if NO_TABLE not in str(error):
                    raise
            else:
                return str(name)
    raise RecordingError(f"{path}: {NO_TABLE} in its sheets {', '.join(map(repr, book.sheet_names))}")


@contextmanager
def _named(exported: Path, path: Path, name: str) -> Iterator[None]:
    """Name the workbook and its sheet in an error."""
    try:
        yield
    except RecordingError as error:
        raise RecordingError(str(error).replace(str(exported), f"{path}, sheet {name!r}")) from error


def write_spreadsheet(_recording: Recording, path: Path) -> NoReturn:
    """Refuse: a workbook holds a million rows at most."""
    raise RecordingError(f"{path}: workbooks are read only; write .csv or .parquet")


def _text(cell: Any) -> str:  # noqa: ANN401  # text, number, truth, date, time or duration
    if isinstance(cell, dt.timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, dt.date | dt.time):
        return cell.isoformat()
    return repr(cell) if isinstance(cell, float) else str(cell).replace(SEPARATOR, " ").replace("\n", " ")
