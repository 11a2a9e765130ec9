"""Head of a delimited text: preamble, names and units of the columns, which of them is the time."""

import re
from collections.abc import Sequence
from pathlib import Path

from piezod.errors import RecordingError
from piezod.recording.formats.text_cells import COMMENTS, date_forms, is_clock, is_number, split_cells
from piezod.recording.names import TIME, unit_of
from piezod.recording.quantities import UNITS, Column, column_of, is_unit

MOST_PREAMBLE_LINES = 1000
"""Lines before the first row of numbers."""

ROW = "row"
"""Name of a first column without a name that counts rows."""

_INTERVAL = re.compile(
    r"(?i)^\W*(sample[ _]interval|sample[ _]time|sampling[ _](?:interval|period)|time[ _]?increment|increment|delta_x"
    r"|dt|abtastintervall|abtastzeit|xincr\w*|horizontal interval)\b[^0-9+\-.]*(?P<value>[0-9.,eE+\-]+)"
)


def head_of(lines: Sequence[str], separator: str, width: int) -> tuple[list[str], list[str], Sequence[str]]:
    """Names, units, and the lines of the preamble above them."""
    rows: list[tuple[int, list[str]]] = []
    for k in range(len(lines) - 1, -1, -1):
        text = lines[k].strip()
        if not text:
            continue
        for mark in COMMENTS:
            text = text.removeprefix(mark)
        cells = split_cells(text.strip(), separator)
        if separator == " " and len(cells) != width:
            cells = [cell.strip() for cell in re.split(r"\s{2,}|\t", text.strip())]
        if len(cells) < width:
            break
        rows.append((k, cells[:width]))
        if len(rows) == 2:
            break
    if not rows:
        keys = metadata_of(lines)
        return [keys[f"NAME{k}"] for k in range(width) if f"NAME{k}" in keys], [], lines
    units = [] if not all(is_unit(cell) or not cell for cell in rows[0][1]) else rows[0][1]
    if units and len(rows) > 1:
        return rows[1][1], units, lines[: rows[1][0]]
    return rows[0][1], [], lines[: rows[0][0]]


def columns_of(
    path: Path,
    named: Sequence[str],
    header: Sequence[str],
    units: Sequence[str],
    rows: Sequence[Sequence[str]],
    width: int,
) -> tuple[Column, ...]:
    """Columns by the user's names, else by the header."""
    if named:
        if len(named) != width:
            raise RecordingError(f"{path}: --columns names {len(named)} columns, the file has {width}")
        return tuple(column_of(name) for name in named)
    if len(header) != width:
        first = ", ".join(rows[0])[:80]
        raise RecordingError(
            f"{path}: has no header for its {width} columns, the first row is {first}; name them, such as "
            "--columns time_s,voltage_V,force_N, or export numbers with decimal commas between semicolons"
        )
    if header[0] == "" and all(header[1:]) and _counts([cells[0] for cells in rows]):
        header = [ROW, *header[1:]]
    if not all(header):
        raise RecordingError(f"{path}: column {list(header).index('') + 1} has no name; name all with --columns")
    if not units:
        return tuple(map(column_of, header))
    return tuple(column_of(name, _further_unit(path, name, unit)) for name, unit in zip(header, units, strict=True))


def _further_unit(path: Path, name: str, unit: str) -> str:
    """Unit from the row of units; empty where the name has it already."""
    known, stated = unit_of(name.strip()), column_of("x", unit).unit
    if known and stated and known != stated:
        both = f"is in {known}, in {stated} by the row of units"
        raise RecordingError(f"{path}: column {name} {both}; correct one of them")
    return "" if known else unit


def _counts(cells: Sequence[str]) -> bool:
    """Whether cells count rows from 0 or 1, as the index that pandas and R write."""
    numbers = [int(cell) for cell in cells if cell.isdecimal() and cell.isascii()]
    return len(numbers) == len(cells) and numbers in (list(range(len(cells))), list(range(1, len(cells) + 1)))


def time_column(
    path: Path, columns: Sequence[Column], rows: Sequence[Sequence[str]], decimal: str
) -> tuple[int, str | None]:
    """Column of time, and the form of its dates; (-1, None) without one."""
    named = [k for k, column in enumerate(columns) if column.quantity == "time"]
    clocks = [k for k in range(len(columns)) if all(is_clock(cells[k]) for cells in rows[:20] if k < len(cells))]
    for k in [k for k in named if k in clocks] or clocks[:1]:
        forms = set(date_forms(rows[0][k])) & set(date_forms(rows[-1][k]))
        days = {cells[k].split("T")[0].split(" ")[0] for cells in rows}
        if not forms or (len(forms) > 1 and len(days) > 1):
            raise RecordingError(f"{path}: {rows[0][k]!r} may be day or month first; write dates as 2026-11-25")
        return k, min(forms)
    numbers = [k for k in named if all(is_number(cells[k], decimal) for cells in rows[:20] if k < len(cells))]
    if len(numbers) > 1:
        names = ", ".join(columns[k].written for k in numbers)
        raise RecordingError(f"{path}: {names} all look like time; name the columns with --columns")
    return (numbers[0], None) if numbers else (-1, None)


def with_time_unit(
    path: Path,
    columns: tuple[Column, ...],
    time: int,
    rows: Sequence[Sequence[str]],
    date_form: str | None,
    notes: list[str],
) -> tuple[Column, ...]:
    """The columns with the unit of time; a time without unit in whole numbers may be milliseconds."""
    column = columns[time]
    if column.quantity != "time":
        column = Column(column.written, "time", "")
    if date_form is None and not column.unit:
        if all(cells[time].strip().lstrip("+-").isdigit() for cells in rows if time < len(cells)):
            raise RecordingError(
                f"{path}: '{column.written}' is in whole numbers without a unit, may be s, ms or a count of samples; "
                "name the columns with --columns time_ms,..., or give --rate-Hz"
            )
        notes.append("time without unit is taken in s")
        column = Column(column.written, "time", "s")
    return (*columns[:time], column, *columns[time + 1 :])


def with_unit(column: Column, notes: list[str]) -> Column:
    """A known quantity without a unit is taken in the first unit of the quantity."""
    if column.quantity in ("voltage", "force") and not column.unit:
        unit = next(iter(UNITS[column.quantity]))
        notes.append(f"'{column.written}' without unit is taken in {unit}")
        return Column(column.written, column.quantity, unit)
    return column


def check_names(path: Path, columns: Sequence[Column]) -> None:
    """Refuse two columns with one name: only the user can choose."""
    by_name: dict[str, list[str]] = {}
    for column in columns:
        by_name.setdefault(column.channel, []).append(column.written)
    for name, written in by_name.items():
        if len(written) > 1 and name != TIME:
            raise RecordingError(
                f"{path}: {' and '.join(repr(w) for w in written)} are both {name}; name the columns with --columns"
            )


def stated_interval_s(lines: Sequence[str], decimal: str) -> float | None:
    """Sample interval that the preamble states [s]: behind its name, or in the line below it."""
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        names, values = line.strip(" ,").lower().split(","), below.strip(" ,").split(",")
        if "increment" in names and len(values) == len(names):
            line = f"increment {values[names.index('increment')]}"  # noqa: PLW2901
        match = _INTERVAL.match(line)
        if match:
            try:
                value = float(match["value"].strip(",").replace(decimal, "."))
            except ValueError:
                continue
            if value > 0.0:
                return value
    return None


def metadata_of(lines: Sequence[str]) -> dict[str, str]:
    """Keys and values of the preamble."""
    metadata = {}
    for line in lines[:MOST_PREAMBLE_LINES]:
        text = line.strip()
        for mark in COMMENTS:
            text = text.removeprefix(mark)
        key, mark, value = (
            re.split(r"(\s*[:=;\t]\s*)", text.strip(), maxsplit=1) if re.search(r"[:=;\t]", text) else ("", "", "")
        )
        if mark and key and value.strip():
            metadata[key.strip().strip('"')] = value.strip().strip('";,')
    return metadata
