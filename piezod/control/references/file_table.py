"""A reference from a CSV file, read to the letter: exact length and period, nothing repaired."""

from pathlib import Path

import numpy as np

from piezod.arrays import Array
from piezod.config.reference import FileReference
from piezod.config.reference_range import ReferenceRange
from piezod.control.references.file_times import check_gaps, tick_positions
from piezod.control.references.folding import folding_amplitude
from piezod.control.references.table import MOST_TICKS, TableReference
from piezod.errors import ConfigurationError, RecordingError
from piezod.recording.formats.strict_csv import StrictTable, read_strict_csv
from piezod.recording.names import unit_of
from piezod.recording.quantities import UNITS

EQUAL = 1e-6
"""Difference of first and last row that counts as none [share of the range]: float32 and seven written digits."""


def file_table(config: FileReference, rate_Hz: float, folder: Path, allowed: ReferenceRange) -> TableReference:
    """Table of a column of a CSV file, interpolated linearly to the ticks.

    The first row is tick 0. The last tick is the last one that is not after the last row.

    Parameters
    ----------
    config
        Section `reference` of the bench configuration.
    rate_Hz
        Tick rate [Hz].
    folder
        Folder that a relative path starts from.
    allowed
        Range of the reference [N].

    Raises
    ------
    ConfigurationError
        The file deviates from the strict format or has no such column. It has a value beyond the range, a gap, or
        content above half the tick rate. The end of a loop is ambiguous.
    """
    try:
        table = read_strict_csv(folder / config.path)
        column = table.column(config.column)
    except RecordingError as error:
        raise ConfigurationError(f"reference.path: {error}") from error
    _check_unit(config)
    force_N = column * config.scale + config.offset_N
    _check_values(config, table, force_N, allowed)
    try:
        check_gaps(table, config.longest_step_s, "reference.longest_step_s")
    except ConfigurationError as error:
        raise ConfigurationError(f"reference.path: {error}") from None
    positions = tick_positions(table.time_s, rate_Hz, table.time_unit_s)
    _check_folding(table, positions, force_N, rate_Hz)
    ticks = _number_of_ticks(config, table, positions, force_N)
    values = np.interp(np.arange(ticks, dtype=np.float64), positions, force_N)
    return TableReference(values, loop=config.loop, ramp_down_on_lapse=config.at_end == "ramp_down")


def _check_unit(config: FileReference) -> None:
    """Refuse a force in another unit that is not converted."""
    unit = unit_of(config.column)
    if unit != "N" and unit in UNITS["force"] and config.scale == 1.0:
        raise ConfigurationError(
            f"reference.column is {config.column}, in {unit}, and reference.scale is 1; set scale to "
            f"{UNITS['force'][unit] / UNITS['force']['N']:g} N per {unit}"
        )


def _check_values(config: FileReference, table: StrictTable, force_N: Array, allowed: ReferenceRange) -> None:
    """Refuse a column with a value beyond the range; interpolation could hide it."""
    bad = np.flatnonzero(~((force_N >= allowed.low_N) & (force_N <= allowed.high_N)))
    if bad.size:
        value_N, time_s = float(force_N[bad[0]]), table.time_s[bad[0]]
        must = allowed.refusal(value_N) if np.isfinite(value_N) else "finite"
        raise ConfigurationError(
            f"reference.path: {table.path}: line {table.lines[bad[0]]}: {config.column} gives {value_N:g} N at "
            f"{time_s:g} s, must be {must}; {bad.size} of {force_N.size} values are wrong: correct the file"
        )


def _check_folding(table: StrictTable, positions: Array, force_N: Array, rate_Hz: float) -> None:
    """Refuse content above half the tick rate."""
    amplitude_N, place = folding_amplitude(positions, force_N)
    if amplitude_N > 0.0:
        line = table.lines[np.searchsorted(positions, place)]
        raise ConfigurationError(
            f"reference.path: {table.path}: from line {line} on it holds {amplitude_N:.3g} N above {rate_Hz / 2:g} Hz, "
            f"half the tick rate, {place / rate_Hz:.6g} s after its start; it would fold to a lower frequency: filter "
            "the file, or raise rate_Hz"
        )


def _number_of_ticks(config: FileReference, table: StrictTable, positions: Array, force_N: Array) -> int:
    """Ticks of a pass. A loop must end on a tick, and its last row must be stated where it repeats the first."""
    end = float(positions[-1])
    if end >= MOST_TICKS:
        raise ConfigurationError(
            f"reference.path: {table.path}: has {end + 1:.0f} ticks, must have at most {MOST_TICKS}"
        )
    if not config.loop:
        return int(end) + 1
    place = f"reference.path: {table.path}: line {table.lines[-1]}, the last one,"
    if end != int(end):
        raise ConfigurationError(f"{place} is {end:.6g} ticks after the first; a loop must be a whole number of ticks")
    repeats = end > 0.0 and bool(abs(force_N[-1] - force_N[0]) <= EQUAL * np.ptp(force_N)) and np.ptp(force_N) > 0.0
    if repeats and config.closing_row is None:
        raise ConfigurationError(
            f"{place} repeats the first row, and reference.loop is true; set reference.closing_row to drop (period "
            f"{end:.0f} ticks) or keep (period {end + 1:.0f} ticks)"
        )
    if config.closing_row == "drop" and not repeats:
        raise ConfigurationError(
            f"{place} differs from the first row, and reference.closing_row is drop; set it to null"
        )
    return int(end) if config.closing_row == "drop" else int(end) + 1
