"""Readings of the ring log beside those that the model expects from the written voltages. Runs in the daemon."""

from math import nan

import numpy as np
from numpy.typing import NDArray

from piezod.model import Model
from piezod.model.expected import ExpectedReading
from piezod.recording.ring_log import ROW_DTYPE
from piezod.recording.ticks import GOOD, pair_rows

LONGEST_GAP_S = 5.0
"""Longest gap of missed ticks that is bridged with the last voltage [s]; after a longer gap the prediction restarts."""


class ExpectedRows:
    """The forward chain of the model beside the rows of one control process after the other.

    Parameters
    ----------
    dt_s
        Tick period [s].

    Attributes
    ----------
    commands, readings
        Rows of commands and of their readings of the last `add`, each shape (N,).
    reading_N, expected_N, corrected_N
        Reading, nan where it failed, reading expected, and force corrected for the load cell, each shape (N,) [N].
    """

    def __init__(self, model: Model, dt_s: float) -> None:
        self._expected, self._dt_s = ExpectedReading(model, dt_s), dt_s
        self._before: NDArray[np.void] | None = None
        self.commands: NDArray[np.void] = np.empty(0, ROW_DTYPE)
        self.readings = self.commands
        self.reading_N = self.expected_N = self.corrected_N = np.empty(0)

    def warm_up(self) -> None:
        """Load the compiled steps."""
        self._expected.run(np.zeros(1), np.full(1, nan))
        self._expected.reset()

    def begin(self) -> None:
        """Begin with a new control process, whose bench is at rest."""
        self._before = None
        self._expected.reset()

    def add(self, rows: NDArray[np.void]) -> bool:
        """Add new rows of the ring log; False where they give no pair, or follow too long a gap."""
        if not rows.size:
            return False
        commands, readings = pair_rows(rows, self._before)
        self._before = rows[-1:].copy()
        if not commands.size:
            return False
        steps = readings["tick"] - commands["tick"]
        if steps.max() * self._dt_s > LONGEST_GAP_S:
            self.begin()
            return False
        last = np.cumsum(steps) - 1
        voltage_V = np.repeat(commands["voltage_V"], steps)
        reading_N = np.full(voltage_V.size, nan)
        reading_N[last] = np.where(readings["result"] == GOOD, readings["force_N"], nan)
        expected, corrected = self._expected.run(voltage_V, reading_N, float(readings["temperature_C"][-1]))
        self.commands, self.readings = commands, readings
        self.reading_N, self.expected_N, self.corrected_N = reading_N[last], expected[last], corrected[last]
        return True
