"""Newest tick of a running daemon as named values in SI units.

The bridge reads the ring log in shared memory, as the live page does. It cannot delay a tick.
"""

import math
from pathlib import Path

from piezod.control import CAUSE_TEXT, Cause, RingReader, State
from piezod.errors import PiezodError
from piezod.recording.age import ValueAge
from piezod.runtime import clock

Values = dict[str, float | int | str | None]

MEASURED = ("reference_N", "force_N", "voltage_V", "readback_V", "temperature_C")
"""Columns of the ring log that are sent under their own names."""

UNITS = {"time_s": "s", "lateness_s": "s", "age_s": "s"} | {name: name.rpartition("_")[2] for name in MEASURED}


class Newest:
    """Reads the newest tick; continues when the daemon restarts.

    Parameters
    ----------
    dt_s
        Time between two ticks [s].

    Attributes
    ----------
    age
        Age of the values.
    last
        Result of the last `read` that was not None; None before.
    """

    def __init__(self, ring_log: Path, dt_s: float) -> None:
        self._path = ring_log
        self._ring: RingReader | None = None
        self._identity: tuple[int, int] | None = None
        self._dt_s = dt_s
        self.age = ValueAge()
        self.last: Values | None = None

    @property
    def stale(self) -> bool:
        """Whether the device gave the values so long ago that they are no present values."""
        return self.age.is_stale(self._dt_s)

    def read(self) -> Values | None:
        """The newest tick; None: none came since the last call.

        Returns
        -------
        dict
            `time_s` since 1970, `tick`, `state` and `cause` in words, measured values, `lateness_s`, `age_s`.
            A value that is not measured is None.
        """
        self._open()
        if self._ring is None or not self._ring.waiting:
            return None
        rows = self._ring.read()
        if not rows.size:
            return None
        self.age.add(rows)
        row = rows[-1]
        since_boot_ns = clock.boot_ns()
        values: Values = {
            "time_s": (clock.wall_ns() - since_boot_ns + int(row["time_ns"])) * 1e-9,
            "tick": int(row["tick"]),
            "state": State(int(row["state"])).name,
            "cause": CAUSE_TEXT[Cause(int(row["cause"]))],
        }
        values |= {name: _finite(float(row[name])) for name in MEASURED}
        self.last = values | {"lateness_s": int(row["lateness_ns"]) * 1e-9, "age_s": self.age.age_s}
        return self.last

    def _open(self) -> None:
        """Open the ring log, and again after a restart of the daemon, which makes a new file of the same name."""
        try:
            found = self._path.stat()
            if (found.st_dev, found.st_ino) != self._identity:
                self._ring = RingReader(self._path)
                self._identity = found.st_dev, found.st_ino
        except (OSError, PiezodError):
            return  # the daemon does not run, or still writes the header


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
