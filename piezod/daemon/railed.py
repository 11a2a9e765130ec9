"""Watch for a reference that is out of reach because the voltage is at a limit. Runs in the daemon.

The limiter cuts a planned voltage outside the permitted range. The force then stays away from its reference, although
nothing is broken. After `daemon.railed_after_s` without a break the bench counts as railed.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, LimitsConfig
from piezod.control import State

LEAST_BEYOND_V = 1e-3
"""Distance of a planned voltage from the range that counts [V]: rounding of a float32 on the wire is smaller."""


class RailedWatch:
    """Time for which the planned voltage lies outside its range while a reference is followed.

    Parameters
    ----------
    log
        Called with one line when the bench gets railed, once for each arming.

    Attributes
    ----------
    railed
        Whether the voltage has been at a limit for longer than `daemon.railed_after_s`.
    lasted_s
        Time for which it has been at the limit without a break [s].
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self._logged = self.railed = False
        self._ticks = 0
        self.lasted_s = 0.0

    def add(self, rows: NDArray[np.void], bench: BenchConfig) -> None:
        """Add new rows of the ring log.

        Parameters
        ----------
        rows
            Rows, shape (N,).
        bench
            Bench configuration of their control process.
        """
        if not rows.size:
            return
        limits = bench.limits
        if (rows["state"] == State.ARMING).any():
            self._logged = False
        beyond_V = max(limits.voltage_step_V, LEAST_BEYOND_V)
        above = rows["planned_V"] > limits.voltage_max_V + beyond_V
        below = rows["planned_V"] < limits.voltage_min_V - beyond_V
        others = np.flatnonzero(~((above | below) & (rows["state"] == State.RUNNING)))
        if others.size:
            self._ticks = int(rows.size - 1 - others[-1])
        else:
            self._ticks += int(rows.size)
        self.lasted_s = self._ticks * bench.dt_s
        self.railed = self.lasted_s > bench.daemon.railed_after_s
        if self.railed and not self._logged:
            self._logged = True
            self._log(_message(float(rows["planned_V"][-1]), self.lasted_s, limits))

    def as_dict(self) -> dict[str, object]:
        """State of the watch, for `piezod status`."""
        return {"railed": self.railed, "lasted_s": round(self.lasted_s, 3)}


def _message(planned_V: float, lasted_s: float, limits: LimitsConfig) -> str:
    above = planned_V > limits.voltage_max_V
    name, limit_V = ("voltage_max_V", limits.voltage_max_V) if above else ("voltage_min_V", limits.voltage_min_V)
    return (
        f"RAILED: the reference needs {planned_V:.1f} V, limits.{name} is {limit_V:g} V, for {lasted_s:.1f} s; "
        "change amplitude or offset of the reference (piezod check prints the reachable forces)"
    )
