"""Rows of the ring log as a recording: one sample says what was commanded last, and which force was measured then.

An exchange reads the force that the command before it has led to, so commands move one row down. A tick that was
missed is a row that is not there; where an exchange failed, what it would have read is nan.
"""

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.stream import Table
from piezod.recording.names import TIME

GOOD = 0
"""`result` of an exchange that did not fail."""

COMMANDS = ("voltage_V", "reference_N", "planned_V")
READINGS = ("force_N", "readback_V", "temperature_C")
OTHERS = ("tick", "state", "cause", "result", "segment", "lateness_ns", "exchange_ns")
WALL = "wall_s"
"""Time of day [s since 1970, UTC]."""


def sample_names(absent: Collection[str]) -> tuple[str, ...]:
    """Columns of the recording, without those that the device does not have."""
    names = (TIME, "voltage_V", "force_N", "reference_N", "readback_V", "temperature_C", "planned_V", *OTHERS, WALL)
    return tuple(name for name in names if name not in absent)


def as_samples(blocks: Iterable[Block], origin_ns: int, wanted: Collection[str]) -> Iterator[Table]:
    """Samples of one block after the other.

    Parameters
    ----------
    blocks
        In the order of their rows.
    origin_ns
        The row clock where `time_s` is 0 [ns].
    wanted
        Names among `sample_names`.
    """
    before = None
    for block in blocks:
        rows = block.rows if before is None else np.concatenate((before, block.rows))
        before = rows[-1:].copy()
        if rows.size > 1:
            table = _samples(rows, block.wall_ns - block.clock_ns, origin_ns)
            yield {name: table[name] for name in wanted}


def _samples(rows: np.ndarray, to_wall_ns: int, origin_ns: int) -> Table:
    commands, answers = rows[:-1], rows[1:]
    table = {name: commands[name].astype(np.float64) for name in COMMANDS}
    table |= {name: np.where(answers["result"] == GOOD, answers[name], np.nan) for name in READINGS}
    table |= {name: answers[name].astype(np.float64) for name in OTHERS}
    table[TIME] = (answers["time_ns"] - origin_ns) * 1e-9
    table[WALL] = (answers["time_ns"] + to_wall_ns) * 1e-9
    return table
