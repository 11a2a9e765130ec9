"""Sequential test with a rate of false alarms: the e-detector of Shiryaev and Roberts.

Each block of time offers a bet against the hypothesis "the law of the bench holds". Its payoff e has the mean 1 under
this hypothesis, at most. The evidence after block k is

    R_k = (1 + R_(k-1)) e_k

the sum of the winnings of all gamblers who began at one of the blocks before. R_k - k has a mean of at most 0, so on
average at least A blocks pass before R reaches A. After an alarm the test begins again.

Source: Shin, Ramdas, Rinaldo, E-detectors, New England J. Stat. Data Sci. 2024, doi:10.51387/23-NEJSDS51, section 2.
A payoff that would carry R beyond A is cut there. The others are raised until the mean is 1 again, so that nothing is
wasted by overshoot. Source: Fischer, Ramdas, arXiv:2410.16076, section 3.
"""

from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array

STAKE = 0.2
"""Power k of the payoff k p^(k-1) of a rank p. With 0.2 a jump above 60 blocks pays 27 times, so five blocks suffice
for odds of 3 million. A smaller k pays less for small changes."""
CLASSES = 512
"""Largest number of outcomes of a rank; more ranks share an outcome. The first then pays 147 times, so three blocks
suffice, and its probability is not that of the one largest block of a reference."""
ROUNDING = 1e-9  # relative, of an evidence that is cut at the level of the alarm


@dataclass(frozen=True)
class Bet:
    """Payoffs of the outcomes of a block under the hypothesis, largest first.

    Parameters
    ----------
    payoffs
        Shape (K,), falling, with the mean 1.
    chances
        Their largest probabilities under the hypothesis, shape (K,), with the sum 1.
    """

    payoffs: Array
    chances: Array

    def capped(self, most: float) -> Array:
        """Payoffs of at most `most`, above 1, with the others raised to the mean 1, shape (K,)."""
        if self.payoffs[0] <= most:
            return self.payoffs
        chance, mean = np.cumsum(self.chances), np.cumsum(self.chances * self.payoffs)
        raised = (1.0 - most * chance[:-1]) / (1.0 - mean[:-1])
        cut = int(np.argmax(raised * self.payoffs[1:] <= most))
        result: Array = np.minimum(self.payoffs * raised[cut], most)
        result[: cut + 1] = most
        return result


@dataclass(frozen=True)
class RankBet:
    """Bet on the rank of a new block among `size` blocks of the reference and itself, the largest first.

    All `size` + 1 ranks are equally likely if the blocks are exchangeable. The payoff of an outcome is the mean of
    k p^(k-1) over its share of 0 < p < 1. An outcome is a rank, or several where there are more than `CLASSES`.
    """

    size: int

    @property
    def classes(self) -> int:
        """Number of outcomes."""
        return min(self.size + 1, CLASSES)

    def outcome(self, rank: int) -> int:
        """Outcome of a block before which `rank` blocks of the reference are."""
        return rank * self.classes // (self.size + 1)

    def payoff(self, outcome: int) -> float:
        """Payoff of an outcome, at any evidence that is far below the level."""
        low, high = self._end(outcome), self._end(outcome + 1)
        return float((high**STAKE - low**STAKE) / (high - low))

    def bet(self) -> Bet:
        """All outcomes."""
        ends = np.array([self._end(k) for k in range(self.classes + 1)])
        chances = np.diff(ends)
        return Bet(np.diff(ends**STAKE) / chances, chances)

    def _end(self, outcome: int) -> float:
        """Share of the ranks before an outcome."""
        ranks = self.size + 1
        return -(-outcome * ranks // self.classes) / ranks


def event_bet(chance: float, stake: float) -> Bet:
    """Bet on an event of at most this probability, outcome 0; outcome 1 is its absence.

    Parameters
    ----------
    stake
        Share of the evidence that is set on the event, in (0, 1).
    """
    win, lose = stake / chance, (1.0 - stake) / (1.0 - chance)
    return Bet(np.array([win, lose]), np.array([chance, 1.0 - chance]))


class DriftAlarm:
    """Evidence against the hypothesis that the law holds.

    Parameters
    ----------
    level
        Mean number of blocks between two false alarms, above 1.

    Attributes
    ----------
    evidence
        R, from 0 to below `level`.
    """

    def __init__(self, level: float) -> None:
        self.level, self.evidence = level, 0.0

    def add_rank(self, rank: int, size: int) -> bool:
        """Add a block with `rank` of `size` blocks of the reference before it; True is an alarm."""
        bet = RankBet(size)
        outcome = bet.outcome(rank)
        if bet.payoff(0) > self._most:
            return self.add(bet.bet(), outcome)
        return self._multiply(bet.payoff(outcome))

    def add(self, bet: Bet, outcome: int) -> bool:
        """Add the outcome of a block, its place in `bet`; True is an alarm, after which the evidence is 0."""
        return self._multiply(float(bet.capped(max(self._most, 1.0))[outcome]))

    @property
    def _most(self) -> float:
        """Payoff that carries the evidence to the level."""
        return self.level / (1.0 + self.evidence)

    def _multiply(self, payoff: float) -> bool:
        self.evidence = (1.0 + self.evidence) * payoff
        if self.evidence < self.level * (1.0 - ROUNDING):
            return False
        self.evidence = 0.0
        return True
