"""Conversion of columns that hold another quantity: the monitor of an amplifier, 10 V/V; a load cell, 100 N/V."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from piezod.errors import RecordingError, UsageError
from piezod.recording.formats.stream import RecordingStream, Table
from piezod.recording.names import TIME, channel_name, unit_of
from piezod.recording.quantities import UNITS

_SCALE = re.compile(
    r"(?P<column>[^=]+)=\s*(?P<factor>[+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)\s*(?P<unit>[^\s/\d]+)(?:/(?P<per>\S+))?"
)


def parse_scale(conversion: str) -> tuple[str, float, str, str]:
    """Column, factor, unit and unit in the file (empty: not stated) of a conversion such as `CH2=100 N/V`.

    Raises
    ------
    UsageError
        It has another form, or the factor is 0.
    """
    match = _SCALE.fullmatch(conversion.strip())
    try:
        factor = float(match["factor"]) if match else 0.0
    except ValueError:
        factor = 0.0
    if match is None or factor == 0.0:
        raise UsageError(f"--scale is '{conversion}', must be COLUMN=FACTOR UNIT, such as 'CH2=100 N/V'")
    return match["column"].strip(), factor, match["unit"], match["per"] or ""


def scaled(stream: RecordingStream, conversions: Sequence[str]) -> RecordingStream:
    """The stream with columns converted: `CH2=100 N/V` makes `CH2_N` of `CH2_V`.

    Parameters
    ----------
    conversions
        As for `parse_scale`.

    Raises
    ------
    RecordingError
        The file has no such column or another unit, or two columns have one name then.
    """
    factors: dict[str, tuple[str, float]] = {}
    for conversion in conversions:
        column, factor, unit, per = parse_scale(conversion)
        name = _column(stream, column)
        stored = unit_of(name)
        base = name.removesuffix(f"_{stored}") if stored else name
        factors[name] = channel_name(base, unit), factor * _in_unit(stream, name, stored, unit, per)
    names = tuple(factors[name][0] if name in factors else name for name in stream.names)
    if len(set(names)) < len(names):
        raise RecordingError(f"{stream.path}: has {', '.join(names)[:120]} after --scale, names must be unique")
    stored_names = dict(zip(names, stream.names, strict=True))

    def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
        for table in stream.chunks([stored_names[name] for name in wanted], chunk):
            values = {name: table[stored_names[name]] for name in wanted}
            yield {
                name: values[name] * factors[stored][1] if (stored := stored_names[name]) in factors else values[name]
                for name in wanted
            }
            stream.metadata["scaled"] = "; ".join(f"{new} is {old} times {by:g}" for old, (new, by) in factors.items())

    return replace(stream, names=names, chunks=chunks)


def _column(stream: RecordingStream, wanted: str) -> str:
    """Name of the column that the user means, with or without its unit."""
    spelt = (wanted, channel_name(wanted))
    found = [name for name in stream.names if name in spelt] or [
        name for name in stream.names if name.removesuffix(f"_{unit_of(name)}") in spelt
    ]
    if len(found) != 1 or found[0] == TIME:
        raise RecordingError(f"{stream.path}: --scale names the column '{wanted}', has {', '.join(stream.names)[:200]}")
    return found[0]


def _in_unit(stream: RecordingStream, name: str, stored: str, unit: str, per: str) -> float:
    """Factor from the unit of the file to the unit that the conversion is stated per."""
    if not stored or stored == per:
        return 1.0
    known = next((units for units in UNITS.values() if stored in units and per in units), None)
    if known is not None:
        return known[stored] / known[per]
    if per or any(units.get(stored, 1.0) != 1.0 for units in UNITS.values()):
        raise RecordingError(f"{stream.path}: {name} is in {stored}; state --scale in {unit}/{stored}")
    return 1.0
