"""Numbers and times from the cells of delimited text: decimal commas, thousands, missing values, dates, clock times."""

import csv
import functools
import re
from datetime import datetime
from math import inf, nan

import numpy as np

from piezod.arrays import Array
from piezod.recording.formats.repairs import MINUS, is_missing

COMMENTS = ("#", "%", "//", "!")
"""Marks at the start of a line without samples."""

ZONE = "%z"  # end of the form of a date or time that states its time zone
ZONES_H = {
    "z": 0,
    "utc": 0,
    "gmt": 0,
    "bst": 1,
    "cet": 1,
    "met": 1,
    "cest": 2,
    "mest": 2,
    "eet": 2,
    "eest": 3,
    "jst": 9,
}
ZONES_H |= {"est": -5, "edt": -4, "cst": -6, "cdt": -5, "mst": -7, "mdt": -6, "pst": -8, "pdt": -7}
"""Hours before UTC of the zones that programs write as a word. Only differences within a file count."""

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
    r"(?:(?P<date>.+?)[T ]+)?(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2}(?:[.,:]\d+)?))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
    rf"\s*(?P<zone>(?i:{'|'.join(ZONES_H)})|[+-]\d{{2}}(?::?\d{{2}})?)?"
)
_DATES: tuple[str, ...] = (
    "%Y-%m-%d",
    "%Y/%m/%d",
    "%Y.%m.%d",
    "%Y%m%d",
    "%d.%m.%Y",
    "%d.%m.%y",
    "%d/%m/%Y",
    "%m/%d/%Y",
    "%d/%m/%y",
)
_DATES += ("%m/%d/%y", "%d-%m-%Y", "%m-%d-%Y", "%d-%b-%Y", "%d-%b-%y", "%d %b %Y", "%b %d, %Y", "%a %b %d %Y")
YEARS = (1970, 2100)  # years of a date; eight digits with another year are a number
DAY_S = 86400.0
CHANGE_S = 3600.0  # jump between winter and summer time [s]
WITHIN_STEPS = 5.0  # largest deviation of the jump from an hour [steps]: some rows may be missing or late
SLOWEST_S = 60.0  # longest usual step in which an hour stands out [s]
EARLIEST_S, LATEST_S = 0.8 * 3600.0, 3.2 * 3600.0
"""Local time before the jump [s after midnight]: the clocks of Europe and America change between 1 and 3 o'clock."""

SUNDAY = 6


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
    if text.lower().lstrip("+-") in ("inf", "infinity"):
        return float(text)  # as `write_csv` writes an infinite value
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
    """The cell without surrounding blanks and blanks after the sign, with a plain minus."""
    text = cell.strip().translate(MINUS)
    return text[0] + text[1:].lstrip() if text[:1] in ("+", "-") else text


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
        Form of the date for `datetime.strptime`, empty without a date; ends in `ZONE` where times state their zone.
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
    if clock is None or (clock["zone"] is not None) != form.endswith(ZONE):
        raise ValueError(text)
    hour = int(clock["h"])
    if clock["half"]:
        hour = hour % 12 + (12 if clock["half"].lower().startswith("p") else 0)
    seconds = float(re.sub("[,:]", ".", clock["s"] or "0"))
    of_day_s = 3600.0 * hour + 60.0 * int(clock["m"]) + seconds - _zone_s(clock["zone"] or "z")
    form = form.removesuffix(ZONE)
    if not form:
        return of_day_s
    return (_day_of(clock["date"] or "", form) - first_day) * DAY_S + of_day_s


def _zone_s(zone: str) -> float:
    """Time of a zone before UTC [s]."""
    if zone.lower() in ZONES_H:
        return 3600.0 * ZONES_H[zone.lower()]
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return float(f"{zone[0]}1") * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))


def day_of(cell: str, form: str) -> int:
    """Ordinal of the day of a cell; 0 for a time without a date."""
    clock = _CLOCK.fullmatch(cell.strip())
    form = form.removesuffix(ZONE)
    return 0 if not form or clock is None else _day_of(clock["date"] or "", form)


@functools.lru_cache(maxsize=64)
def _day_of(date: str, form: str) -> int:
    return datetime.strptime(date, form).toordinal()  # noqa: DTZ007  only differences count


def date_forms(cell: str) -> list[str]:
    """Forms of dates that a cell may have; [''] for a time without a date. Each ends in `ZONE` with a zone."""
    clock = _CLOCK.fullmatch(cell.strip())
    zone = ZONE if clock is not None and clock["zone"] else ""
    if clock is None or not clock["date"]:
        return [zone]
    return [form + zone for form in forms_of_date(clock["date"])]


def forms_of_date(date: str) -> list[str]:
    """Forms that a date without a time may have."""
    forms = []
    for form in _DATES:
        try:
            year = datetime.strptime(date, form).year  # noqa: DTZ007
        except ValueError:
            continue
        if YEARS[0] <= year <= YEARS[1]:
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


class ClockChange:
    """Takes jumps of an hour out of consecutive blocks of local times.

    Parameters
    ----------
    first_day
        Ordinal of the day that times count from; 0: the stamps have no date. With dates, only a Sunday counts.
    """

    def __init__(self, first_day: int) -> None:
        self._first_day = first_day
        self._end_s = self._step_s = np.nan
        self._shift_s = 0.0
        self.notes: list[str] = []

    def corrected(self, times_s: Array) -> Array:
        """Times without the jumps; `notes` names each.

        Parameters
        ----------
        times_s
            Local times since midnight of the first day, shape (N,) [s].
        """
        before_s = np.concatenate([[self._end_s], times_s[:-1]])
        steps_s = times_s - before_s
        rising_s = steps_s[steps_s > 0.0]
        if rising_s.size:
            self._step_s = float(np.median(rising_s))
        changes = np.zeros(times_s.size)
        for k in np.flatnonzero(np.abs(np.abs(steps_s - self._step_s) - CHANGE_S) <= WITHIN_STEPS * self._step_s):
            if self._step_s <= SLOWEST_S and self._may_change(float(before_s[k])):
                changes[k] = CHANGE_S if steps_s[k] > self._step_s else -CHANGE_S
                direction = "forward" if changes[k] > 0.0 else "back"
                self.notes.append(f"the clock is set {direction} by an hour after {_clock(before_s[k])}, taken out")
        self._end_s = float(times_s[-1])
        shifts = self._shift_s + np.cumsum(changes)
        self._shift_s = float(shifts[-1])
        return times_s - shifts

    def _may_change(self, time_s: float) -> bool:
        is_sunday = not self._first_day or (self._first_day + int(time_s // DAY_S) - 1) % 7 == SUNDAY
        return is_sunday and EARLIEST_S <= time_s % DAY_S <= LATEST_S


def _clock(time_s: float) -> str:
    seconds = int(time_s % DAY_S)
    return f"{seconds // 3600:02}:{seconds % 3600 // 60:02}:{seconds % 60:02}"
