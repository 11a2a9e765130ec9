"""Test of one block after the other: whether the law of the model still holds, and whether the input is known.

- Known input, 60 blocks like it were driven: its rank among these blocks counts.
- New input in the first stretch of driving: it counts whether it is above a multiple of the model's own error.
- New input after the first stretch, or outside of the model's range: the block is not compared.

The first stretch of driving is the first hour of a bench with its model. It must agree with the model: it becomes the
reference of all blocks after it.
"""

from dataclasses import dataclass
from enum import Enum

from piezod.daemon.drift.alarm import DriftAlarm, event_bet
from piezod.daemon.drift.blocks import Block, Cell
from piezod.daemon.drift.reference import BlockReference

OVER_LIMIT = event_bet(chance=0.01, stake=0.5)
"""Bet of the first stretch. A model that holds leaves three times its own error in one block of a hundred at most. Four
blocks in a row above the limit then have odds of 6 million."""
BEYOND_RANGE = 0.05  # share of the model's input range by which a block may leave it
LEAST_N = 1e-9  # distance of a block without any difference


class BlockResult(Enum):
    """Comparison of a block."""

    KNOWN = "compared with known blocks"
    FIRST = "compared with the limit"
    OUTSIDE = "not compared"


@dataclass(frozen=True)
class Tested:
    """Result of a block.

    Parameters
    ----------
    distance_N, usual_N
        Distance from the model, and median distance of the known blocks of this kind [N]; None: not known.
    alarm
        Whether the law has changed.
    """

    result: BlockResult
    cell: Cell
    distance_N: float
    usual_N: float | None
    alarm: bool


class LawTest:
    """The test of a bench with its model.

    Parameters
    ----------
    reference
        Known blocks; grows with the blocks that are tested.
    limit_N
        Limit of the first stretch [N].
    level
        Mean number of blocks between two false alarms.
    """

    def __init__(self, reference: BlockReference, limit_N: float, level: float) -> None:
        self.reference, self._limit_N = reference, limit_N
        self.alarm = DriftAlarm(level)

    def add(self, block: Block, offset_N: float) -> Tested:
        """Test a block, and add it to the reference.

        Parameters
        ----------
        offset_N
            Its mean difference relative to the first block of the drive [N].
        """
        known, cell = self.reference, block.cell(self.reference.range_V)
        distance_N = max(block.distance_N(offset_N, known.own_N), LEAST_N)
        usual_N = None
        alarm = False
        if known.is_known(cell):
            result, usual_N = BlockResult.KNOWN, known.median_N(cell)
            alarm = self.alarm.add_rank(known.rank(cell, distance_N), known.blocks_of(cell))
        elif known.is_first_stretch and self._is_in_range(block):
            result = BlockResult.FIRST
            alarm = self.alarm.add(OVER_LIMIT, 0 if distance_N > self._limit_N else 1)
        else:
            result = BlockResult.OUTSIDE
        if alarm:
            known.forget_waiting()
        else:
            known.add(cell, distance_N)
        return Tested(result, cell, distance_N, usual_N, alarm)

    def _is_in_range(self, block: Block) -> bool:
        low_V, high_V = self.reference.range_V
        beyond_V = BEYOND_RANGE * (high_V - low_V)
        return low_V - beyond_V <= block.low_V and block.high_V <= high_V + beyond_V
