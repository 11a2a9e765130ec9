"""Times of a file that drives a bench, in ticks: exact number of ticks, and no gap between two rows."""

import numpy as np

from piezod.arrays import Array
from piezod.errors import ConfigurationError
from piezod.recording.formats.strict_csv import StrictTable

GAP = 10.0  # Longest step between two rows [median steps]. A file with a longer one lacks rows, or has two rates
EVEN_GAP = 1.5  # the same for a file whose other rows are evenly spaced: there a single row is missing
EVEN_SHARE, EVEN_WITHIN = 0.9, 0.02
"""Share of the steps that make rows evenly spaced, and their largest deviation from the median [median steps]."""

FLOAT_ERROR = 1e-6  # deviation of a time from a tick that summed or stored floating-point times have [ticks]
FEWEST_ROUNDED = 10  # rows from which unequal steps of rounded times show the tick rate


def tick_positions(time_s: Array, rate_Hz: float, time_unit_s: float = 0.0) -> Array:
    """Time of each row since the first row [ticks]. A row that is meant to be on a tick gives a whole number.

    A time counts as on a tick within floating-point error. Times such as 0.003333, 0.006667, 0.010000 are rounded:
    their steps differ although every row is within the last decimal of its own tick. They count as on these ticks.

    Parameters
    ----------
    time_s
        Times, never falling, shape (N,) [s].
    rate_Hz
        Tick rate [Hz].
    time_unit_s
        Unit of the last written decimal [s]; 0: unknown.
    """
    since_s = time_s - time_s[0]
    if _are_rounded_ticks(since_s, rate_Hz, time_unit_s):
        return np.arange(time_s.size, dtype=np.float64)
    positions: Array = since_s * rate_Hz
    whole = np.rint(positions)
    error = max(FLOAT_ERROR, 4.0 * float(np.spacing(np.abs(time_s).max())) * rate_Hz)
    return np.where(np.abs(positions - whole) <= min(error, 0.01), whole, positions)


def _are_rounded_ticks(since_s: Array, rate_Hz: float, time_unit_s: float) -> bool:
    """Whether row k is at tick k, with a rounded time."""
    if since_s.size < FEWEST_ROUNDED or not 0.0 < time_unit_s * rate_Hz <= 0.5:
        return False
    units = np.rint(since_s / time_unit_s)
    ticks = np.arange(since_s.size) / rate_Hz
    are_unequal = np.ptp(np.diff(units)) > 0.0
    return bool(are_unequal and (np.abs(since_s - ticks) <= 1.001 * time_unit_s).all())


def check_gaps(table: StrictTable, longest_step_s: float | None, key: str = "") -> None:
    """Refuse a file with a step that is longer than stated.

    Parameters
    ----------
    longest_step_s
        Longest step [s]; None: `GAP` times the median step, `EVEN_GAP` times it for evenly spaced rows, with `key`.
    key
        Key that states it, for the message; empty: there is none.

    Raises
    ------
    ConfigurationError
        The message names both lines, the step and the limit.
    """
    steps_s = np.diff(table.time_s)
    rising_s = steps_s[steps_s > 0.0]
    if not rising_s.size:
        return
    median_s = float(np.median(rising_s))
    is_even = bool(key) and rising_s.size >= FEWEST_ROUNDED and _is_even(rising_s, median_s, table.time_unit_s)
    factor = EVEN_GAP if is_even else GAP
    longest_s = factor * median_s if longest_step_s is None else longest_step_s
    gaps = np.flatnonzero(steps_s > longest_s * (1.0 + 1e-9))
    if gaps.size:
        k = gaps[0]
        words = f"{factor:g} times the median step" if longest_step_s is None else key
        remedy = f"add the missing rows, or set {key}" if key else "add the missing rows"
        raise ConfigurationError(
            f"{table.path}: line {table.lines[k + 1]} is {steps_s[k]:.6g} s after line {table.lines[k]}, must be at "
            f"most {longest_s:.6g} s, {words}; {remedy}"
        )


def _is_even(steps_s: Array, median_s: float, time_unit_s: float) -> bool:
    """Whether nearly all steps are equal within the rounding of the times."""
    rounding_s = 1.001 * time_unit_s if median_s > 2.0 * time_unit_s else 0.0
    return bool(np.mean(np.abs(steps_s - median_s) <= EVEN_WITHIN * median_s + rounding_s) >= EVEN_SHARE)
