"""Numbers and times from the cells of delimited text: decimal commas, thousands, missing values, dates, clock times."""

import csv
import re
from datetime import datetime
from math import inf, nan

from piezod.recording.formats.repairs import MINUS, is_missing

COMMENTS = ("#", "%", "//", "!")
"""Marks at the start of a line without samples."""

_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?", re.ASCII),
    ",": re.compile(r"[+-]?(?:\d+,?\d*|,\d+)(?:[eEdD][+-]?\d+)?", re.ASCII),
}
_GROUPED = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}(?:[,'\u2019\u00a0\u202f ]\d{3})+(?:\.\d+)?", re.ASCII),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}(?:[.'\u2019\u00a0\u202f ]\d{3})+(?:,\d+)?", re.ASCII),
}
_UNDECIDED = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_CLOCK = re.compile(
    r"(?:(?P<date>.+?)[T ]+)?(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2}(?:[.,:]\d+)?))?\s*(?P<half>[AaPp][Mm])?Z?"
)
_DATES = ("%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%m/%d/%Y")
DAY_S = 86400.0


def number(cell: str, decimal: str, *, grouped: bool) -> float:
    """Number in a cell; nan for a missing sample.

    Parameters
    ----------
    cell
        Text of the cell, without quotes.
    decimal
        Decimal mark, a point or a comma.
    grouped
        Whether marks may group thousands: in a file without them, `12.345` is no number next to decimal commas.

    Raises
    ------
    ValueError
        The cell holds no number.
    """
    text = _plain(cell)
    if is_missing(text):
        return nan
    if _NUMBER[decimal].fullmatch(text):
        return float(text.replace(decimal, ".").replace("d", "e").replace("D", "e"))
    if grouped and _GROUPED[decimal].fullmatch(text):
        return float(
            re.sub(r"[^\d.+-]", "", text) if decimal == "." else re.sub(r"[^\d,+-]", "", text).replace(",", ".")
        )
    raise ValueError(text)


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell holds a number or a word for a missing sample."""
    text = _plain(cell)
    return bool(is_missing(text) or _NUMBER[decimal].fullmatch(text) or _GROUPED[decimal].fullmatch(text))


def _plain(cell: str) -> str:
    """The cell without surrounding blanks, with a plain minus."""
    return cell.strip().replace(MINUS, "-")


def is_grouped(cell: str, decimal: str) -> bool:
    """Whether marks group the thousands of a number, as in `1'234.5`."""
    return bool(_GROUPED[decimal].fullmatch(cell.strip())) and not _NUMBER[decimal].fullmatch(cell.strip())


def is_undecided(cell: str) -> bool:
    """Whether `1,234` may be 1.234 or 1234."""
    return bool(_UNDECIDED.fullmatch(cell.strip()))


def is_clock(cell: str) -> bool:
    """Whether a cell holds a time of day, with or without a date."""
    return bool(_CLOCK.fullmatch(cell.strip()))


def clock_s(cell: str, form: str, first_day: int) -> float:
    """Time of a cell since midnight [s], of the first day where it has a date; nan for a missing one.

    Parameters
    ----------
    cell
        `12:30:01.250`, `2026-11-25T12:30:01`, `25.11.2026 12:30:01,25`.
    form
        Form of the date for `datetime.strptime`; empty: there is none.
    first_day
        Ordinal of the first day, see `day_of`.

    Raises
    ------
    ValueError
        The cell holds no time of this form.
    """
    text = cell.strip()
    if is_missing(text):
        return nan
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        raise ValueError(text)
    hour = int(clock["h"])
    if clock["half"]:
        hour = hour % 12 + (12 if clock["half"].lower() == "pm" else 0)
    seconds = float(re.sub("[,:]", ".", clock["s"] or "0"))
    of_day_s = 3600.0 * hour + 60.0 * int(clock["m"]) + seconds
    if not form:
        return of_day_s
    return (day_of(cell, form) - first_day) * DAY_S + of_day_s


def day_of(cell: str, form: str) -> int:
    """Ordinal of the day of a cell; 0 for a time without a date."""
    clock = _CLOCK.fullmatch(cell.strip())
    if not form or clock is None:
        return 0
    return datetime.strptime(clock["date"] or "", form).toordinal()  # noqa: DTZ007  only differences count


def date_forms(cell: str) -> list[str]:
    """Forms of dates that a cell may have; [''] for a time without a date."""
    clock = _CLOCK.fullmatch(cell.strip())
    if clock is None or not clock["date"]:
        return [""]
    forms = []
    for form in _DATES:
        try:
            datetime.strptime(clock["date"], form)  # noqa: DTZ007
        except ValueError:
            continue
        forms.append(form)
    return forms


def unwrapped(times_s: list[float], before_s: float) -> list[float]:
    """Times of day that continue after midnight.

    Parameters
    ----------
    times_s
        Times of day [s].
    before_s
        The unwrapped time before the first [s]; -inf: none.
    """
    result, day_s = [], 0.0 if before_s == -inf else before_s // DAY_S * DAY_S
    for time_s in times_s:
        if time_s + day_s < before_s - DAY_S / 2:
            day_s += DAY_S
        before_s = time_s + day_s
        result.append(before_s)
    return result


def split_cells(line: str, separator: str) -> list[str]:
    """Cells of a line, without quotes and surrounding blanks; empty cells at its end are dropped."""
    text = line.strip("\r\n\x00")
    if separator == " ":
        return text.split()
    cells = next(csv.reader([text], delimiter=separator), []) if '"' in text else text.split(separator)
    cells = [cell.strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    return cells
