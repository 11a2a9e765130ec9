"""Channels converted to the unit that a command needs, from any multiple in the file."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.names import TIME, unit_of
from piezod.recording.quantities import UNITS, column_of
from piezod.recording.recording import Recording

DEFAULTS = {"input": "voltage_V", "output": "force_N"}  # channels that a model is identified on unless others are named
ROLE_WORDS = {
    "input": "input in u v voltage spannung tension command cmd drive excitation stimulus",
    "output": "output out y force kraft response position pos displacement weg travel stroke strain measured",
}
"""Words by which the names of columns identify input and output."""

NO_SIGNALS = ("time", "temperature", "current", "reference", "row")
"""Quantities that are neither input nor output unless they are named."""

PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6}
SCALED = ("V", "N")  # units of channels of any name of which a file may hold a multiple


def factor_to(wanted: str, name: str) -> float:
    """Factor from a channel of a file to a requested channel; 0 if the quantities differ.

    Parameters
    ----------
    wanted
        Name of the channel that is wanted, such as `force_N`, or `-force_N` for its negative.
    name
        Name of the channel in the file, such as `force_kN` or `force_lbf`.
    """
    if name == wanted:
        return 1.0
    if wanted.startswith("-"):
        return -factor_to(wanted[1:], name)
    unit, stored = unit_of(wanted), unit_of(name)
    quantity = wanted.removesuffix(f"_{unit}")
    if not unit or not stored or name.removesuffix(f"_{stored}") != quantity:
        return 0.0
    known = UNITS.get(quantity, {})
    if unit in known and stored in known:
        return known[stored] / known[unit]
    return PREFIXES.get(stored.removesuffix(unit), 0.0) if unit in SCALED and stored.endswith(unit) else 0.0


def stored_column(path: Path, names: Sequence[str], wanted: str) -> tuple[str, float]:
    """Name of a wanted channel in a file, and the factor to its unit.

    Parameters
    ----------
    wanted
        Name of the channel that is wanted.

    Raises
    ------
    RecordingError
        The file has no such channel; the message names the existing channels.
    """
    for name in (wanted, *names):
        if name in names and name != TIME and (factor := factor_to(wanted, name)):
            return name, factor
    present = ", ".join(name for name in names if name != TIME)
    raise RecordingError(
        f"{path}: has no column {wanted}, has {present[:200]}; name one with --input or --output, or all with --columns"
    )


def choose_columns(path: Path, names: Sequence[str], given: Mapping[str, str | None]) -> tuple[str, str, list[str]]:
    """Names of the input and the output that a model is identified on, where the user has not named both.

    The voltage and the force, in any unit, come first. Else the names decide, or, of two channels, the other.

    Parameters
    ----------
    given
        `input` and `output` as the user named them; None: not named.

    Returns
    -------
    input, output, notes
        The names, and a line for each that was chosen by other than its default.

    Raises
    ------
    RecordingError
        The names do not identify the columns; the message names the options.
    """
    free = [name for name in names if column_of(name).quantity not in NO_SIGNALS and name not in given.values()]
    chosen = {role: name for role, name in given.items() if name is not None}
    for role, default in DEFAULTS.items():
        if role not in chosen and any(factor_to(default, name) for name in free):
            chosen[role] = default
            free = [name for name in free if not factor_to(default, name)]
    defaults = dict(chosen)
    for role, words in ROLE_WORDS.items():
        named = [name for name in free if set(words.split()) & set(re.split(r"[\W_]+", name.lower()))]
        if role not in chosen and len(named) == 1:
            chosen[role] = named[0]
            free.remove(named[0])
    for role in DEFAULTS:
        if role not in chosen and len(chosen) == 1 and len(free) == 1:
            chosen[role] = free.pop()
    for role, default in DEFAULTS.items():
        if role not in chosen:
            stored_column(path, names, default)
    others = {role: name for role, name in chosen.items() if role not in defaults}
    notes = [f"the {role} is the column {name}; --{role} names another" for role, name in others.items()]
    return chosen["input"], chosen["output"], notes


def in_units_of(recording: Recording, wanted: Sequence[str]) -> tuple[Recording, list[str]]:
    """A recording whose channels have the wanted names and units, as far as it has them in another multiple.

    Parameters
    ----------
    recording
        The recording; it is not changed.

    Returns
    -------
    recording, notes
        The recording, and a line for each channel that was converted.
    """
    channels, notes = dict(recording.channels), []
    for name in wanted:
        held = next((other for other in channels if other != name and factor_to(name, other)), None)
        if name in channels or held is None:
            continue
        factor = factor_to(name, held)
        channels[name] = np.asarray(channels.pop(held)) * factor
        notes.append(f"{name}: is {held} times {factor:g}")
    return Recording(recording.time_s, channels, recording.metadata, recording.source), notes
