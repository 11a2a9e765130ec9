"""Rows of the ring log in a `.sqlite` recording, as samples with a time, commands and readings."""

from collections.abc import Collection, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.stream import Table
from piezod.recording.names import TIME
from piezod.recording.ticks import GOOD, pair_rows

COMMANDS = ("voltage_V", "reference_N", "planned_V")
READINGS = ("force_N", "readback_V", "temperature_C")
OTHERS = ("tick", "state", "cause", "result", "segment", "lateness_ns", "exchange_ns")
WALL = "wall_s"  # time of day [s since 1970, UTC]


def sample_names(absent: Collection[str]) -> tuple[str, ...]:
    """Columns of the recording.

    Parameters
    ----------
    absent
        Columns that the device lacks; they are skipped.
    """
    names = (TIME, "voltage_V", "force_N", "reference_N", "readback_V", "temperature_C", "planned_V", *OTHERS, WALL)
    return tuple(name for name in names if name not in absent)


def as_samples(blocks: Iterable[Block], origin_ns: int, wanted: Collection[str]) -> Iterator[Table]:
    """Samples, block by block.

    Parameters
    ----------
    blocks
        Blocks in the order of their rows.
    origin_ns
        Time of the row clock at which `time_s` is 0 [ns].
    wanted
        Names among `sample_names`.
    """
    before = None
    for block in blocks:
        commands, readings = pair_rows(block.rows, before)
        before = block.rows[-1:].copy() if block.rows.size else before
        if commands.size:
            table = _samples(commands, readings, block.wall_ns - block.clock_ns, origin_ns)
            yield {name: table[name] for name in wanted}


def _samples(commands: NDArray[np.void], readings: NDArray[np.void], to_wall_ns: int, origin_ns: int) -> Table:
    table = {name: commands[name].astype(np.float64) for name in COMMANDS}
    table |= {name: np.where(readings["result"] == GOOD, readings[name], np.nan) for name in READINGS}
    table |= {name: readings[name].astype(np.float64) for name in OTHERS}
    table[TIME] = (readings["time_ns"] - origin_ns) * 1e-9
    table[WALL] = (readings["time_ns"] + to_wall_ns) * 1e-9
    return table
