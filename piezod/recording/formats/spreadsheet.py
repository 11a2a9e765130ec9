"""Recordings in a workbook of Excel or LibreOffice (.xlsx, .xls, .ods): read only.

The first sheet that holds a table of numbers is read as the text that the spreadsheet itself would export. So names,
units, dates and missing columns are handled equally. Library: python-calamine.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library
from piezod.recording.formats.spreadsheet_export import export_table
from piezod.recording.formats.stream import RecordingStream
from piezod.recording.formats.text import open_text
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.recording import Recording


@contextmanager
def open_spreadsheet(path: Path, options: TextOptions = TextOptions()) -> Iterator[RecordingStream]:  # noqa: B008
    """Open a workbook.

    Parameters
    ----------
    options
        Layout as the user states it; `decimal` has no effect.

    Raises
    ------
    RecordingError
        No sheet holds a table of numbers, python-calamine is not installed, or as for `open_text`.
    """
    import_library("python_calamine", "xlsx", path)
    options = replace(options, decimal=".")
    with tempfile.TemporaryDirectory() as folder:
        exported = Path(folder) / "sheet.tsv"
        name = export_table(path, exported, options)
        with _named(exported, path, name), open_text(exported, options) as stream:
            understood = stream.metadata["understood"].split(", ", 3)[3]  # behind separator, decimal mark and encoding
            yield replace(
                stream, path=path, metadata={**stream.metadata, "understood": f"sheet {name!r}, {understood}"}
            )


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
