"""What the ring log told, kept as a whole and turned into recordings and timing figures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.control import ROW_DTYPE, State
from piezod.recording import HELD_ONE_SAMPLE, Recording

GOOD = 0  # ExchangeResult.OK


@dataclass(frozen=True)
class TimingFigures:
    """Lateness of the wake-up and duration of the tick from wake-up to committed state, in microseconds."""

    ticks: int
    lateness_us: dict[str, float]
    completion_us: dict[str, float]


class History:
    """All rows of a session."""

    def __init__(self) -> None:
        self._chunks: list[NDArray[np.void]] = []

    def add(self, rows: NDArray[np.void]) -> None:
        """Keep more rows."""
        if rows.size:
            self._chunks.append(rows)

    @property
    def rows(self) -> NDArray[np.void]:
        """Everything so far, oldest first."""
        return np.concatenate(self._chunks) if self._chunks else np.empty(0, ROW_DTYPE)

    def recording(self, segment: int, *, metadata: dict[str, str], follows_force: bool = True) -> Recording:
        """Rows of one segment while it was followed.

        One row of a recording says what was commanded last and which force was measured then: an exchange reads the
        force that the command before it has led to, so commands move one row down.

        Parameters
        ----------
        segment
            Its number, from 0.
        metadata
            Written into the recording, beside how its command was held and read.
        follows_force
            Whether the reference is a force [N]; else it was the voltage itself and is left out.
        """
        rows = self.rows
        rows = rows[rows["segment"] == segment]
        commands, answers = rows[:-1], rows[1:]
        running = (
            (commands["state"] == State.RUNNING) & (answers["state"] == State.RUNNING) & (answers["result"] == GOOD)
        )
        commands, answers = commands[running], answers[running]
        start_ns = answers["time_ns"][0] if answers.size else 0
        channels = {
            "voltage_V": commands["voltage_V"].copy(),
            "force_N": answers["force_N"].copy(),
        }
        if follows_force:
            channels["reference_N"] = commands["reference_N"].copy()
        for name, field in (("readback_V", "readback_V"), ("temperature_C", "temperature_C")):
            if np.isfinite(answers[field]).any():
                channels[name] = answers[field].copy()
        return Recording((answers["time_ns"] - start_ns) * 1e-9, channels, metadata | HELD_ONE_SAMPLE.metadata)

    def timing(self) -> TimingFigures:
        """Percentiles over every tick that wrote."""
        rows = self.rows
        rows = rows[(rows["state"] != State.DISARMED) & (rows["state"] != State.FAULT)]
        return TimingFigures(
            ticks=int(rows.size),
            lateness_us=percentiles(rows["lateness_ns"] * 1e-3),
            completion_us=percentiles((rows["lateness_ns"] + rows["exchange_ns"]) * 1e-3),
        )


def percentiles(values: NDArray[np.float64]) -> dict[str, float]:
    """p50, p99, p99.9 and the largest; nan when there are no values."""
    if not values.size:
        return dict.fromkeys(("p50", "p99", "p99.9", "max"), float("nan"))
    p50, p99, p999 = np.percentile(values, (50, 99, 99.9))
    return {"p50": float(p50), "p99": float(p99), "p99.9": float(p999), "max": float(values.max())}
