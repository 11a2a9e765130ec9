"""All rows of a session, and their evaluation: recordings and timing figures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.control import ROW_DTYPE, State
from piezod.recording import Recording
from piezod.recording.hold import HELD_ONE_SAMPLE
from piezod.recording.ticks import GOOD, pair_rows

OnRows = Callable[[NDArray[np.void]], None]
"""Called about ten times per second with the new rows of the ring log, shape (N,)."""


@dataclass(frozen=True)
class TimingFigures:
    """Timing of the ticks that wrote a voltage.

    Parameters
    ----------
    lateness_us
        Wake-up after the deadline: percentiles and maximum [us].
    completion_us
        From the deadline to the committed state: percentiles and maximum [us].
    """

    ticks: int
    lateness_us: dict[str, float]
    completion_us: dict[str, float]


class History:
    """All rows of a session, in memory."""

    def __init__(self) -> None:
        self._chunks: list[NDArray[np.void]] = []

    def add(self, rows: NDArray[np.void]) -> None:
        """Append rows of the ring log."""
        if rows.size:
            self._chunks.append(rows)

    @property
    def rows(self) -> NDArray[np.void]:
        """All rows, oldest first."""
        return np.concatenate(self._chunks) if self._chunks else np.empty(0, ROW_DTYPE)

    def recording(self, segment: int, *, metadata: dict[str, str], follows_force: bool = True) -> Recording:
        """Make a recording of one segment while it was followed.

        Each sample joins a command with the force that it caused (`recording/ticks.py`).

        Parameters
        ----------
        segment
            Number of the segment, from 0.
        metadata
            Metadata of the recording; the hold of the command is added.
        follows_force
            Whether the reference is a force [N]. The voltage reference of a direct drive is omitted.
        """
        rows = self.rows
        commands, readings = pair_rows(rows[rows["segment"] == segment])
        tracking = is_tracking(commands, readings)
        commands, readings = commands[tracking], readings[tracking]
        start_ns = readings["time_ns"][0] if readings.size else 0
        channels = {
            "voltage_V": commands["voltage_V"].copy(),
            "force_N": readings["force_N"].copy(),
        }
        if follows_force:
            channels["reference_N"] = commands["reference_N"].copy()
        for name in ("readback_V", "temperature_C"):
            if np.isfinite(readings[name]).any():
                channels[name] = readings[name].copy()
        return Recording((readings["time_ns"] - start_ns) * 1e-9, channels, metadata | HELD_ONE_SAMPLE.metadata)

    def timing(self) -> TimingFigures:
        """Timing figures over every tick that wrote a voltage."""
        rows = self.rows
        rows = rows[(rows["state"] != State.DISARMED) & (rows["state"] != State.FAULT)]
        return TimingFigures(
            ticks=int(rows.size),
            lateness_us=percentiles(rows["lateness_ns"] * 1e-3),
            completion_us=percentiles((rows["lateness_ns"] + rows["exchange_ns"]) * 1e-3),
        )


def is_tracking(commands: NDArray[np.void], readings: NDArray[np.void]) -> NDArray[np.bool_]:
    """Mask of the pairs that belong to a followed reference: both rows are RUNNING and the reading is good.

    Parameters
    ----------
    commands, readings
        Result of `pair_rows`, each of shape (N,).

    Returns
    -------
    numpy.ndarray
        Mask of shape (N,).
    """
    running = (commands["state"] == State.RUNNING) & (readings["state"] == State.RUNNING)
    tracking: NDArray[np.bool_] = running & (readings["result"] == GOOD)
    return tracking


def percentiles(values: NDArray[np.float64]) -> dict[str, float]:
    """Percentiles 50, 99 and 99.9 and the maximum; nan without values.

    Parameters
    ----------
    values
        Shape (N,), any unit.
    """
    if not values.size:
        return dict.fromkeys(("p50", "p99", "p99.9", "max"), float("nan"))
    p50, p99, p999 = np.percentile(values, (50, 99, 99.9))
    return {"p50": float(p50), "p99": float(p99), "p99.9": float(p999), "max": float(values.max())}
