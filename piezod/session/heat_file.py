"""The heat of the stack between two runs of the daemon: kept with its time, and cooled by the clock.

A run reads and removes the file at its start and writes it at its end. Where there is none, the last run has ended
without a word, and the stack may be as hot as its limit allows.
"""

import contextlib
import json
import math

from piezod.config import BenchConfig
from piezod.config.regular_file import open_regular
from piezod.errors import ConfigurationError
from piezod.runtime import clock
from piezod.runtime.files import written

LARGEST = 1024  # largest file that is read [byte]


class HeatFile:
    """Heat of one bench.

    Parameters
    ----------
    bench
        Bench configuration; the file lies in the folder of its ring log.
    """

    def __init__(self, bench: BenchConfig) -> None:
        self._path = bench.ring_log_path.with_name(bench.ring_log_path.name + ".heat")
        self._limit_W = bench.limits.dissipation_max_W or 0.0
        self._over_s = bench.limits.dissipation_over_s

    def pop(self) -> float:
        """Mean power that the stack turned into heat before, as it counts now [W]; the file is removed.

        Without a file: the limit of the bench.
        """
        try:
            with open_regular(self._path, LARGEST) as file:
                content = json.load(file)
            power_W, time_s = float(content["power_W"]), float(content["time_s"])
            self._path.unlink()
        except (ConfigurationError, OSError, ValueError, TypeError, KeyError, RecursionError):
            return self._limit_W
        if not (math.isfinite(power_W) and math.isfinite(time_s) and power_W >= 0.0):
            return self._limit_W
        age_s = max(clock.wall_s() - time_s, 0.0)  # a clock that was set back cools nothing
        return min(power_W * math.exp(-age_s / self._over_s), self._limit_W)

    def keep(self, power_W: float) -> None:
        """Write the heat of a run that ends; an error leaves no file.

        Parameters
        ----------
        power_W
            `Outcome.heat_W` [W].
        """
        content = json.dumps({"power_W": power_W, "time_s": clock.wall_s()})
        try:
            written(self._path, content)
        except ConfigurationError:
            with contextlib.suppress(OSError):
                self._path.unlink()
