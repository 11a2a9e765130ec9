"""Channel names of recordings: words joined by underscores, the unit last, such as `force_N` or `slew_V_per_s`."""

import re
from collections.abc import Iterable
from pathlib import Path

from piezod.errors import RecordingError

TIME = "time_s"  # name of the time column [s]
_BRACKETED = re.compile(r"^(?P<name>.*\S)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_UNIT = re.compile(r"._(?P<unit>[^_]+(?:_per_[^_]+)?)$")
_RATE = re.compile(r"._(?P<above>[numck]?m|in|deg|rad|rev)_(?P<below>s2?|min|h)$")  # velocity_cm_s
# Characters of units and their replacement in a name. Unicode has mu and ohm twice: as a letter and as a sign.
_SPELT = {"µ": "u", "\u03bc": "u", "°": "deg", "\u03a9": "ohm", "\u2126": "ohm", "%": "percent"}
_SPELT |= {"²": "2", "³": "3", "/": "_per_"}
_SPELT_IN_FULL = {"°C": "C", "degC": "C", "-": "", "1": ""}


def channel_name(name: str, unit: str = "") -> str:
    """Channel name from the name and unit in a file: `Force`, `kN` -> `Force_kN`.

    Parameters
    ----------
    name
        Name in the file; a unit in brackets at its end is taken as the unit: `Force [N]`.
    unit
        Unit in the file; empty: none. It is not appended to a name that already ends in it.
    """
    name = name.strip()
    bracketed = _BRACKETED.match(name)
    if bracketed:
        name, unit = bracketed["name"], unit.strip() or bracketed["unit"]
    words = re.sub(r'[\s,"]+', "_", name.strip(' ,"'))
    suffix = _spell(unit)
    if suffix and not words.endswith((f"_{suffix}", f"_{unit.strip()}")):
        words = f"{words}_{suffix}"
    return TIME if words.lower() == TIME else words


def unit_of(name: str) -> str:
    """Unit at the end of a channel name: `slew_V_per_s` -> `V_per_s`; empty for a name without unit.

    A way or an angle over a time needs no `per`: `velocity_cm_s` -> `cm_per_s`.
    """
    if rate := _RATE.search(name):
        return f"{rate['above']}_per_{rate['below']}"
    match = _UNIT.search(name)
    return match["unit"] if match else ""


def name_columns(path: Path, columns: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Channel names of a file's columns.

    Parameters
    ----------
    columns
        (name, unit) of each column in the file.

    Raises
    ------
    RecordingError
        A name is empty, two names are equal, or none is `time_s`.
    """
    names = tuple(channel_name(name, unit) for name, unit in columns)
    if "" in names:
        raise RecordingError(f"{path}: column {names.index('') + 1} has no name; every column must be named")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise RecordingError(f"{path}: has {', '.join(repeated)[:120]} twice; column names must be unique")
    if TIME not in names:
        raise RecordingError(f"{path}: has no {TIME}, has {', '.join(names)[:120] or 'no columns of numbers'}")
    return names


def _spell(unit: str) -> str:
    """Unit in the spelling of names: `m/s²` -> `m_per_s2`."""
    unit = _SPELT_IN_FULL.get(unit.strip(), unit.strip())
    for sign, word in _SPELT.items():
        unit = unit.replace(sign, word)
    return re.sub(r"[^\w]+", "", unit)
