"""Channel names: words joined by underscores that end in the unit, wherever name and unit came from."""

import re
from collections.abc import Iterable
from pathlib import Path

from piezod.errors import RecordingError

TIME = "time_s"

_BRACKETED = re.compile(r"^(?P<name>.*\S)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_UNIT = re.compile(r"._(?P<unit>[^_]+(?:_per_[^_]+)?)$")
# How the signs in units are spelt in a name; mu and ohm exist as letter and as sign.
_SPELT = {"µ": "u", "\u03bc": "u", "°": "deg", "\u03a9": "ohm", "\u2126": "ohm", "%": "percent"}
_SPELT |= {"²": "2", "³": "3", "/": "_per_"}
_SPELT_WHOLE = {"°C": "C", "degC": "C", "-": "", "1": ""}


def channel_name(name: str, unit: str = "") -> str:
    """Make the project's name from a file's name and unit: `Force`, `kN` -> `Force_kN`.

    Parameters
    ----------
    name
        As the file has it; a unit in brackets at its end counts as its unit: `Force [N]`.
    unit
        As the file has it, empty if it has none. Not added to a name that ends in it.
    """
    name = name.strip()
    bracketed = _BRACKETED.match(name)
    if bracketed:
        name, unit = bracketed["name"], unit.strip() or bracketed["unit"]
    words = "_".join(name.split())
    suffix = _spell(unit)
    if suffix and not words.endswith((f"_{suffix}", f"_{unit.strip()}")):
        words = f"{words}_{suffix}"
    return TIME if words.lower() == TIME else words


def unit_of(name: str) -> str:
    """Unit that a channel's name ends in, empty if it has none: `slew_V_per_s` -> `V_per_s`."""
    found = _UNIT.search(name)
    return found["unit"] if found else ""


def name_columns(path: Path, columns: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Names of a file's columns from their (name, unit).

    Raises
    ------
    RecordingError
        Two columns have one name, one has none, or none is the time.
    """
    names = tuple(channel_name(name, unit) for name, unit in columns)
    if "" in names:
        raise RecordingError(f"{path}: column {names.index('') + 1} has no name; every column must be named")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RecordingError(f"{path}: has {', '.join(twice)[:120]} twice; column names must be unique")
    if TIME not in names:
        raise RecordingError(f"{path}: has no {TIME}, has {', '.join(names)[:120] or 'no columns of numbers'}")
    return names


def _spell(unit: str) -> str:
    """Unit as it stands in a name: `m/s²` -> `m_per_s2`."""
    unit = _SPELT_WHOLE.get(unit.strip(), unit.strip())
    for sign, word in _SPELT.items():
        unit = unit.replace(sign, word)
    return re.sub(r"[^\w]+", "", unit)
