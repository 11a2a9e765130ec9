"""Head of a delimited text: preamble, names and units of the columns, which of them is the time."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from piezod.errors import RecordingError
from piezod.recording.formats.text_cells import (
    COMMENTS,
    ZONE,
    date_forms,
    forms_of_date,
    is_clock,
    is_number,
    split_cells,
)
from piezod.recording.names import TIME, unit_of
from piezod.recording.quantities import UNITS, Column, column_of, is_unit

MOST_PREAMBLE_LINES = 1000  # lines before the first row of numbers
MOST_HEAD_ROWS = 5  # rows of names, units and information on the channels, directly above the samples
SECONDS = ("s", "ms", "us", "ns")  # units by which the only column that has one of them is the time
ROW = "row"  # name of a first column without a name that counts rows
YEARS = (1_000_000_000, 4_000_000_000)  # times since 1970 that are taken for such: from 2001 to 2096 [s]
_INTERVAL = re.compile(
    r"(?i)^\W*(sample[ _]interval|sample[ _]time|sampling[ _](?:interval|period)|time[ _]?increment|increment|delta_x"
    r"|dt|abtastintervall|abtastzeit|xincr\w*|horizontal interval)\b[^0-9+\-.]*(?P<value>[0-9.,eE+\-]+)"
)


@dataclass(frozen=True)
class Head:
    """Names, units, the lines above them, the lines that hold them, and the names behind the last cell of a row."""

    names: list[str]
    units: list[str]
    above: Sequence[str]
    lines: frozenset[str] = frozenset()
    extra: tuple[str, ...] = ()


def head_of(lines: Sequence[str], separator: str, width: int) -> Head:
    """Head of a table.

    Parameters
    ----------
    lines
        All lines above the first row. A name in quotes may have several lines.
    width
        Cells of a row.
    """
    lines = _with_whole_quotes(lines)
    rows: list[tuple[int, list[str]]] = []
    for k in range(len(lines) - 1, -1, -1):
        text = lines[k].strip(" \r\n")
        if not text.strip():
            continue
        for mark in COMMENTS:
            text = text.removeprefix(mark)
        cells = split_cells(text.strip(" "), separator)
        if separator == " " and len(cells) != width:
            cells = [cell.strip() for cell in re.split(r"\s{2,}|\t", text.strip())]
        if len(cells) < width:
            if cells and separator != " " and text.count(separator) >= width - 1:
                continue  # one setting for all columns, such as `SR=200 Hz;;`
            break
        rows.append((k, cells))
        if len(rows) == MOST_HEAD_ROWS:
            break
    if not rows:
        keys = metadata_of(lines)
        return Head([keys[f"NAME{k}"] for k in range(width) if f"NAME{k}" in keys], [], lines)
    at = next((k for k, (_, cells) in enumerate(rows[:-1]) if are_units(cells[:width])), -1)
    place, names = rows[at + 1]
    return Head(
        names[:width],
        rows[at][1][:width] if at >= 0 else [],
        lines[:place],
        frozenset(lines[k].strip() for k, _ in rows[: at + 2]),
        tuple(names[width:]),
    )


def are_units(cells: Sequence[str]) -> bool:
    """Whether a row holds nothing but units, at least one."""
    return any(cells) and all(is_unit(cell) or not cell for cell in cells)


def _with_whole_quotes(lines: Sequence[str]) -> list[str]:
    """The lines, joined where a quoted text goes on in the next line."""
    whole: list[str] = []
    waiting: list[str] = []
    for line in lines:
        waiting.append(line)
        if sum(text.count('"') for text in waiting) % 2 == 0:
            whole.append(" ".join(waiting))
            waiting = []
    return whole + waiting


def columns_of(
    path: Path, named: Sequence[str], head: Head, rows: Sequence[Sequence[str]], width: int
) -> tuple[Column, ...]:
    """Columns by the user's names, else by the header; a column that the user does not want has no name."""
    header, units = list(head.names), head.units
    if chosen := chosen_columns(named):
        for written in chosen.values():
            if header.count(written) != 1:
                known = ", ".join(header)[:160] or "no header"
                raise RecordingError(f"{path}: --columns names the column '{written}', the file has {known}")
        by_place = {header.index(written): name for name, written in chosen.items()}
        return tuple(column_of(by_place[k]) if k in by_place else Column("", "", "") for k in range(width))
    if named:
        if len(named) != width:
            raise RecordingError(f"{path}: --columns names {len(named)} columns, the file has {width}")
        return tuple(column_of(name) for name in named)
    if len(header) != width:
        first = ", ".join(rows[0])[:80]
        whole = not any(mark in cell for cell in rows[0] for mark in ".,")
        hint = ", or export numbers with decimal commas between semicolons" if whole else ""
        raise RecordingError(
            f"{path}: has no header for its {width} columns, the first row is {first}; name them, such as "
            f"--columns time_s,voltage_V,force_N{hint}"
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
    known = known if is_unit(known) else ""
    if known and stated and known != stated:
        both = f"is in {known}, in {stated} by the row of units"
        raise RecordingError(f"{path}: column {name} {both}; correct one of them")
    return "" if known else unit


def _counts(cells: Sequence[str]) -> bool:
    """Whether cells count rows from 0 or 1, as the index that pandas and R write."""
    numbers = [int(cell) for cell in cells if cell.isdecimal() and cell.isascii()]
    return len(numbers) == len(cells) and numbers == list(range(numbers[0], numbers[0] + len(cells)))


def chosen_columns(named: Sequence[str]) -> dict[str, str]:
    """Wanted columns as {name: name or path in the file}; empty where none is stated as `NAME=WRITTEN`."""
    return {
        name.strip(): written.strip()
        for name, mark, written in (entry.partition("=") for entry in named)
        if mark or any("=" in entry for entry in named)
    }


def time_column(
    path: Path, columns: Sequence[Column], rows: Sequence[Sequence[str]], decimal: str
) -> tuple[int, str | None, int]:
    """Column of time, the form of its dates, and the column of the date where it is another one; -1: none."""

    def all_are(k: int, is_such: Callable[[str], bool]) -> bool:
        return all(is_such(cells[k]) for cells in rows[:20] if k < len(cells))

    named = [k for k, column in enumerate(columns) if column.quantity == "time"]
    in_s = [k for k, column in enumerate(columns) if column.unit in SECONDS]
    named = named or (in_s if len(in_s) == 1 else [])
    clocks = [k for k in range(len(columns)) if columns[k].written and all_are(k, is_clock)]
    numbers = [k for k in named if all_are(k, lambda cell: is_number(cell, decimal))]
    with_unit = [k for k in numbers if columns[k].unit]
    for k in [] if len(with_unit) == 1 else [k for k in named if k in clocks] or clocks[:1]:
        dates = [
            m for m in range(len(columns)) if m not in clocks and all_are(m, lambda cell: bool(forms_of_date(cell)))
        ]
        at = dates[0] if dates and set(date_forms(rows[0][k])) <= {"", ZONE} else -1
        stamps = [joined(rows[0], at, k), joined(rows[-1], at, k)]
        forms = set(date_forms(stamps[0])) & set(date_forms(stamps[1]))
        days = {joined(cells, at, k).split("T")[0].split(" ")[0] for cells in rows}
        if not forms or (len(forms) > 1 and len(days) > 1):
            raise RecordingError(f"{path}: {stamps[0]!r} may be day or month first; write dates as 2026-11-25")
        return k, min(forms), at
    if len(numbers) > 1 and len(with_unit) != 1:
        names = ", ".join(columns[k].written for k in numbers)
        raise RecordingError(f"{path}: {names} all look like time; name the columns with --columns")
    return (with_unit or numbers or [-1])[0], None, -1


def joined(cells: Sequence[str], date: int, time: int) -> str:
    """Date and time of day of a row as one text."""
    return cells[time] if date < 0 else f"{cells[date]} {cells[time]}"


def with_time_unit(
    path: Path,
    columns: tuple[Column, ...],
    time: int,
    rows: Sequence[Sequence[str]],
    date_form: str | None,
    notes: list[str],
) -> tuple[tuple[Column, ...], bool]:
    """The columns with the unit of time, and whether it counts from 1970."""
    column = columns[time]
    if column.quantity != "time":
        column = Column(column.written, "time", column.unit if column.unit in SECONDS else "")
    since_1970 = False
    if date_form is None and not column.unit:
        cells = [row[time].strip() for row in rows if time < len(row)]
        unit = "s"
        if all(cell.lstrip("+-").isdigit() for cell in cells):
            unit = unit_since_1970([int(cell) for cell in cells])
            since_1970 = bool(unit)
        elif is_serial_day([cell.replace(",", ".") for cell in cells]):
            unit = ""
        if not unit:
            raise RecordingError(
                f"{path}: '{column.written}' is {cells[0][:20]} without unit, may be s, ms, days or a count; "
                "name the columns with --columns time_ms,..., or give --rate-Hz"
            )
        notes.append(f"time counts {unit} since 1970" if since_1970 else "time without unit is taken in s")
        column = Column(column.written, "time", unit)
    return (*columns[:time], column, *columns[time + 1 :]), since_1970


def unit_since_1970(values: Sequence[int]) -> str:
    """Unit of whole times that count from 1970, by their size; empty for other numbers."""
    low, high = min(values), max(values)
    units = (unit for unit, ticks in (("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)) if YEARS[0] * ticks <= low)
    return next((unit for unit in units if high <= YEARS[1] / UNITS["time"][unit]), "")


def is_serial_day(cells: Sequence[str]) -> bool:
    """Whether times may be days as a spreadsheet or MATLAB counts them: of a date since 2000, over less than a week."""
    try:
        first, last = float(cells[0]), float(cells[-1])
    except ValueError:
        return False
    return any(low <= first <= last < min(first + 7.0, low + 40_000) for low in (36_526, 730_486))


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
