"""Quantities and units by the words that spreadsheets and instruments use, in English, German and French.

`U [mV]`, `Spannung in mV` and `tension_mV` are the channel `voltage_mV`. A name that is not known stays as it is.
"""

import re
import unicodedata
from dataclasses import dataclass

from piezod.recording.names import TIME, channel_name, unit_of

WORDS = {
    "time": "time zeit temps t x_value x_axis timestamp zeitstempel elapsed horodatage uhrzeit datum date datetime",
    "voltage": "voltage spannung tension u v volt volts voltage_out ausgangsspannung",
    "force": "force kraft effort f load last loadcell load_cell kraftmesser",
    "displacement": "displacement weg deplacement travel hub extension",
    "temperature": "temperature temperatur temp",
    "current": "current strom courant i",
    "reference": "reference sollwert soll setpoint consigne",
}
"""Words for each quantity, in lower case and without accents."""

UNITS = {
    "time": dict.fromkeys(("s", "sec", "sek", "seconds"), 1.0)
    | {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "voltage": {"V": 1.0, "mV": 1e-3, "kV": 1e3, "uV": 1e-6},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "uN": 1e-6}
    | {"lbf": 4.4482216152605, "kgf": 9.80665, "kip": 4448.2216152605},
    "displacement": {"um": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6, "mic": 1.0, "in": 25400.0},
    "temperature": {"C": 1.0, "degC": 1.0},
    "current": {"A": 1.0, "mA": 1e-3, "uA": 1e-6},
    "reference": {},
}
"""Units of each quantity, with their value in the first unit of the quantity.

The pound-force is 0.45359237 kg times 9.80665 m/s2 (NIST Special Publication 811, 2008, appendix B.8); a kip is 1000.
"""

SPELT = {"Volt": "V", "Volts": "V", "volt": "V", "volts": "V", "Newton": "N", "newton": "N"}
SPELT |= {"S": "s", "\u00b5s": "us", "\u03bcs": "us"}
SPELT |= {
    word: unit
    for unit, words in {
        "s": "sec sek second seconds sekunden",
        "ms": "msec millisec millisecond milliseconds millisekunden",
        "us": "usec microsec microsecond microseconds mikrosekunden",
        "ns": "nsec nanosecond nanoseconds",
        "min": "minute minutes minuten",
        "h": "hr hour hours stunden",
        "d": "day days tage",
    }.items()
    for word in words.split()
}
"""Other spellings of units; words in lower case."""

COUNTS = ("sequence", "index", "sample", "samples", "no", "nr", "#")
"""Words in place of a unit for a column that counts the rows."""

_QUANTITY = {word: quantity for quantity, words in WORDS.items() for word in words.split()}
_TRAILING_UNIT = re.compile(r"^(?P<name>.+?)(?:\s+in\s+|\s*/\s*|\s*,\s*|_|\s+)(?P<unit>[^\s/,_]+)$")


@dataclass(frozen=True)
class Column:
    """A column of a text file.

    Parameters
    ----------
    quantity
        A key of `WORDS`; empty: unknown.
    unit
        Its unit as channel names spell it; empty: none is given.
    """

    written: str
    quantity: str
    unit: str

    @property
    def channel(self) -> str:
        """Name of the channel, such as `voltage_mV`; an unknown quantity keeps its own name."""
        if self.quantity == "time":
            return TIME
        if self.quantity and self.unit:
            return f"{self.quantity}_{self.unit}"
        return channel_name(self.written, self.unit)


def column_of(written: str, unit: str = "") -> Column:
    """Quantity and unit of a column.

    Parameters
    ----------
    written
        Name in the file, perhaps with its unit: `U [mV]`, `Kraft/kN`, `Weg in um`, `voltage_V`.
    unit
        Unit from a row of units; empty: none.
    """
    if not unit and (quantity := _QUANTITY.get(_plain(written))):
        return Column(written.strip(), quantity, "")
    name = channel_name(written.strip().strip('"'), _spelt(unit.strip("[]() ")))
    given = unit_of(name)
    base = name.removesuffix(f"_{given}") if given else name
    if not given and (match := _TRAILING_UNIT.match(written.strip())):
        base, given = match["name"], channel_name("x", match["unit"]).removeprefix("x_")
    quantity = _QUANTITY.get(_plain(base), "")
    given = _spelt(given)
    known = UNITS.get(quantity, {})
    if given and quantity and known and given not in known:
        lower = {name.lower(): name for name in known}
        given = lower.get(given.lower(), given) if given.lower() not in ("mv", "mn") else given
        if given not in known:
            quantity, given = _QUANTITY.get(_plain(name), ""), ""
    if not quantity and not given:
        quantity = _QUANTITY.get(_plain(name), "")
    return Column(written.strip(), quantity, given)


def is_unit(text: str) -> bool:
    """Whether a cell holds only a unit, perhaps in brackets, as in a row of units."""
    bare = channel_name("x", text.strip().strip("[]()").strip()).removeprefix("x_")
    return (
        any(_spelt(bare) in units for units in UNITS.values())
        or text.strip() in ("-", "[-]", "%")
        or text.strip().lower() in COUNTS
    )


def _spelt(unit: str) -> str:
    return SPELT.get(unit) or SPELT.get(unit.lower(), unit)


def _plain(text: str) -> str:
    """Lower case without accents, with underscores between words."""
    letters = unicodedata.normalize("NFKD", text.strip().strip(":").lower())
    return re.sub(r"[\s\-.]+", "_", "".join(c for c in letters if not unicodedata.combining(c))).strip("_")
