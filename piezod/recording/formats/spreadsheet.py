"""Recordings in a workbook of Excel or LibreOffice (.xlsx, .xls, .ods): read only.

The first sheet that holds a table of numbers is read as the text that the spreadsheet itself would export. So names,
units, dates and missing columns are handled equally. Library: python-calamine.

A workbook is compressed and names its own size: 1.4 kB can claim 17 thousand million cells. The library then aborts
the process, or takes all memory. So a child process with limits exports the text, and its end is an error of one line.
"""

import contextlib
import datetime as dt
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NoReturn

from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library, library_errors
from piezod.recording.formats.stream import RecordingStream
from piezod.recording.formats.text import open_text
from piezod.recording.formats.text_layout import TextOptions, find_layout
from piezod.recording.recording import Recording
from piezod.runtime.interpreter import python

SEPARATOR = "\t"
NO_TABLE = "holds no table of numbers"

MOST_MEMORY = 2**31  # Address space of the child [byte]. A full sheet of a million rows and ten columns takes 1 GB
MOST_TEXT = 2**30  # largest exported text [byte]: a hundred million cells
WITHIN_S = 120  # processor time of the child [s]; a full sheet takes 20 s


@contextmanager
def open_spreadsheet(path: Path, options: TextOptions) -> Iterator[RecordingStream]:
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
        name = _export_table(path, exported, options)
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


def _export_table(path: Path, exported: Path, options: TextOptions) -> str:
    """Write the first sheet with a table of numbers as text; return its name.

    Parameters
    ----------
    options
        Layout of the table as the user states it.

    Raises
    ------
    RecordingError
        No sheet holds a table of numbers, or the workbook is damaged or needs more than the limits.
    """
    arguments = json.dumps({"path": str(path), "exported": str(exported), "options": asdict(options)})
    command = "from piezod.recording.formats.spreadsheet import run_child; run_child()"
    done = subprocess.run(  # noqa: S603  # this interpreter and fixed text
        python("-c", command), input=arguments, capture_output=True, text=True, check=False
    )
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        raise RecordingError(
            f"{path}: cannot be read: it needs more than {MOST_MEMORY >> 30} GiB of memory or {WITHIN_S} s, or is "
            "damaged; save the sheet as .csv"
        ) from None
    if "error" in answer:
        raise RecordingError(answer["error"])
    return str(answer["sheet"])


def run_child() -> None:
    """Export with limits; the request is on stdin, the answer on stdout."""
    request = json.load(sys.stdin)
    with contextlib.suppress(ModuleNotFoundError):  # Windows has no limits
        _set_limits()
    path, about = Path(request["path"]), request["options"]
    options = TextOptions(tuple(about["columns"]), about["rate_Hz"], about["decimal"])
    try:
        with library_errors(path, "read"):
            answer = {"sheet": _export(path, Path(request["exported"]), options)}
    except RecordingError as error:
        answer = {"error": str(error)}
    sys.stdout.write(json.dumps(answer))


def _set_limits() -> None:
    """Limit memory, written bytes and time of this process."""
    import resource  # noqa: PLC0415  # not on Windows

    for limit, value in (
        (resource.RLIMIT_AS, MOST_MEMORY),
        (resource.RLIMIT_FSIZE, MOST_TEXT),
        (resource.RLIMIT_CPU, WITHIN_S),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(limit, (value, value))


def _export(path: Path, exported: Path, options: TextOptions) -> str:
    library = import_library("python_calamine", "xlsx", path)
    with library.CalamineWorkbook.from_path(str(path)) as book:
        for name in book.sheet_names:
            with exported.open("w", encoding="utf-8") as file:
                for row in book.get_sheet_by_name(name).iter_rows():
                    file.write(SEPARATOR.join(map(_text, row)) + "\n")
            try:
                find_layout(exported, options)
            except RecordingError as error:
                if NO_TABLE not in str(error):
                    raise RecordingError(str(error).replace(str(exported), f"{path}, sheet {name!r}")) from error
            else:
                return str(name)
        raise RecordingError(f"{path}: {NO_TABLE} in its sheets {', '.join(map(repr, book.sheet_names))}")


def _text(cell: Any) -> str:  # noqa: ANN401  # text, number, truth, date, time or duration
    if isinstance(cell, dt.timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, dt.date | dt.time):
        return cell.isoformat()
    return repr(cell) if isinstance(cell, float) else str(cell).replace(SEPARATOR, " ").replace("\n", " ")
