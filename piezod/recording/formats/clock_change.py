"""Change between winter and summer time in local time stamps."""

import numpy as np

from piezod.arrays import Array
from piezod.recording.formats.text_cells import DAY_S

CHANGE_S = 3600.0
WITHIN_STEPS = 5.0  # largest deviation of the jump from an hour [steps]: some rows may be missing or late
SLOWEST_S = 60.0  # longest usual step in which an hour stands out [s]
EARLIEST_S, LATEST_S = 0.8 * 3600.0, 3.2 * 3600.0
"""Local time before the jump [s after midnight]: the clocks of Europe and America change between 1 and 3 o'clock."""

SUNDAY = 6


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
