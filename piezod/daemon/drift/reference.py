"""Distances of earlier blocks, by the kind of their input; a new block is ranked among them.

Only blocks of one kind are compared, so an error that depends on the work is no drift, and no distribution is assumed.
A kind with too few blocks is an input that the bench was not driven with.

A block joins the reference a few minutes later, so that blocks after a change are not compared with themselves.
With a growing reference the ranks of exchangeable blocks are independent and equally likely: Vovk, Gammerman, Shafer,
Algorithmic Learning in a Random World, 2005, theorem 8.2.
A fixed one has an uncertain tail: Shaer et al., arXiv:2602.13848.
That an input outside of the reference is no change of the law: Prinster et al., arXiv:2505.04608.
"""

from collections import deque
from dataclasses import dataclass, field
from math import exp, floor, log

import numpy as np
from numpy.typing import NDArray

from piezod.daemon.drift.blocks import KELVIN, PARTS, Block, Cell

FEWEST = 60  # blocks of a cell before one is ranked: the rank of a jump then pays 27 times (`alarm.STAKE`)
MOST_CELLS = 256  # of a reference: 4 MB
DELAY = 12  # blocks after which a block joins the reference: twice the blocks in which a jump is seen
FIRST_STRETCH = 360
"""Blocks of the first stretch of driving: an hour of blocks of 10 s. An input that is new later is other work."""
STEP = 0.005  # of the logarithm of a distance, over the model's own error: 0.5 %
STEPS = 2000  # on either side of the model's own error: factors of 22,000


@dataclass
class BlockReference:
    """Blocks of one bench with one model.

    Parameters
    ----------
    range_V, own_N
        Input range of the model [V], and its own error [N].
    tolerance
        Growth of the error that is no drift [1].
    counts
        For each kind of input, shape (2 STEPS + 1,): element k counts the blocks of at least distance k. Distance k is
        own_N exp(STEP (k - STEPS)).
    """

    range_V: tuple[float, float]
    own_N: float
    tolerance: float
    counts: dict[Cell, NDArray[np.int32]] = field(default_factory=dict)
    _waiting: deque[tuple[Cell, int]] = field(default_factory=deque)

    @property
    def size(self) -> int:
        """Number of blocks."""
        return sum(map(self.blocks_of, self.counts))

    def blocks_of(self, cell: Cell) -> int:
        """Number of blocks of a kind."""
        return int(self.counts[cell][0]) if cell in self.counts else 0

    @property
    def is_first_stretch(self) -> bool:
        """Whether the first stretch of driving is not complete."""
        return self.size < FIRST_STRETCH

    def is_known(self, cell: Cell) -> bool:
        """Whether a cell has enough blocks for a comparison."""
        return self.blocks_of(cell) >= FEWEST

    def rank(self, cell: Cell, distance_N: float) -> int:
        """Number of blocks of a known cell that are at least as far from the model; the tolerance is subtracted."""
        return int(self.counts[cell][self._step(distance_N / (1.0 + self.tolerance))])

    def median_N(self, cell: Cell) -> float:
        """Median distance of a known cell [N]."""
        counts = self.counts[cell]
        middle = int(np.searchsorted(-counts, -counts[0] / 2, side="right")) - 1
        return self.own_N * exp(STEP * (middle - STEPS))

    def add(self, cell: Cell, distance_N: float) -> None:
        """Add a block, which joins the reference after `DELAY` further blocks."""
        self._waiting.append((cell, self._step(distance_N)))
        if len(self._waiting) > DELAY:
            self.insert(*self._waiting.popleft())

    def insert(self, cell: Cell, step: int, number: int = 1) -> None:
        """Add blocks of a distance at once."""
        counts = self.counts.get(cell)
        if counts is None:
            if len(self.counts) >= MOST_CELLS:
                return
            counts = self.counts[cell] = np.zeros(2 * STEPS + 1, np.int32)
        counts[: step + 1] += number

    def forget_waiting(self) -> None:
        """Drop the blocks that have not joined: they may be from after a change."""
        self._waiting.clear()

    def difference_of(self, block: Block) -> str:
        """Difference of a block's input from the known cells, in words with values and units."""
        cell = block.cell(self.range_V)
        known = [other for other in self.counts if self.is_known(other)]
        if not known:
            return "no input is known yet"
        low_V, part_V = self.range_V[0], (self.range_V[1] - self.range_V[0]) / PARTS
        least, most = (Cell(*(end(values) for values in zip(*known, strict=True))) for end in (min, max))
        texts = []
        if cell.low < least.low or cell.high > most.high:
            seen = f"{low_V + part_V * least.low:.4g} to {low_V + part_V * most.high:.4g} V"
            texts.append(f"voltage {block.low_V:.4g} to {block.high_V:.4g} V, known {seen}")
        for name, value, unit, at in (
            ("rate", block.rate_V_per_s, "V/s", "rate"),
            ("frequency", block.frequency_Hz, "Hz", "frequency"),
        ):
            ends = getattr(least, at), getattr(most, at)
            if not ends[0] <= getattr(cell, at) <= ends[1]:
                texts.append(
                    f"{name} {value:.3g} {unit}, known {2.0 ** ends[0]:.3g} to {2.0 ** (ends[1] + 1):.3g} {unit}"
                )
        if not least.temperature <= cell.temperature <= most.temperature:
            ends = (least.temperature - 0.5) * KELVIN, (most.temperature + 0.5) * KELVIN
            texts.append(f"temperature {block.temperature_C:.1f} degC, known {ends[0]:.1f} to {ends[1]:.1f} degC")
        return "; ".join(texts) or f"this combination of range, rate and frequency, in {FEWEST} windows"

    def _step(self, distance_N: float) -> int:
        return min(max(floor(log(distance_N / self.own_N) / STEP) + STEPS, 0), 2 * STEPS)
