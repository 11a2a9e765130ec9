"""The e-detector: payoffs have the mean 1, and exchangeable blocks alarm once in `level` blocks."""

import numpy as np
import pytest

from piezod.daemon.drift.alarm import CLASSES, DriftAlarm, RankBet, event_bet
from piezod.daemon.drift.blocks import Block
from piezod.daemon.drift.reference import DELAY, FEWEST, BlockReference


@pytest.mark.parametrize("size", [1, 60, CLASSES - 1, CLASSES, 5000])
def test_the_mean_payoff_of_equally_likely_ranks_is_one(size):
    bet = RankBet(size)
    payoffs = [bet.payoff(bet.outcome(rank)) for rank in range(size + 1)]
    assert np.mean(payoffs) == pytest.approx(1.0, rel=1e-12)
    assert payoffs == sorted(payoffs, reverse=True)
    highest = -(-(size + 1) // CLASSES)  # ranks of the first outcome
    assert payoffs[0] == pytest.approx(((size + 1) / highest) ** 0.8, rel=1e-12)


@pytest.mark.parametrize("most", [1.01, 2.0, 20.0, 1000.0])
@pytest.mark.parametrize("bet", [RankBet(60).bet(), RankBet(5000).bet(), event_bet(0.01, 0.5)])
def test_a_cut_payoff_leaves_the_mean_at_one(bet, most):
    capped = bet.capped(most)
    assert float(capped @ bet.chances) == pytest.approx(1.0, rel=1e-12)
    assert capped.max() <= most or bet.payoffs[0] <= most
    assert (np.diff(capped) <= 1e-12).all()


def test_exchangeable_blocks_alarm_once_in_the_level_on_average():
    """The ranks are drawn; 200 alarms are expected, with a standard deviation of 14."""
    random, alarm, level = np.random.default_rng(1), DriftAlarm(500.0), 500
    ranks = random.integers(0, 201, 200 * level)
    alarms = sum(alarm.add_rank(int(rank), 200) for rank in ranks)
    assert 200 - 3 * 14 < alarms < 200 + 3 * 14


def test_evidence_is_the_sum_over_all_gamblers():
    """Three bets with the payoffs a, b, c: abc + bc + c."""
    alarm, bet = DriftAlarm(1e9), RankBet(60)
    for rank in (3, 0, 7):
        alarm.add_rank(rank, 60)
    a, b, c = (bet.payoff(rank) for rank in (3, 0, 7))
    assert alarm.evidence == pytest.approx(a * b * c + b * c + c, rel=1e-12)


def test_five_blocks_above_sixty_known_ones_are_an_alarm_of_a_year():
    alarm = DriftAlarm(365 * 8640.0)
    assert [alarm.add_rank(0, FEWEST) for _ in range(5)] == [False, False, False, False, True]
    assert alarm.evidence == 0.0


def block(rate_V_per_s=100.0):
    return Block(0.1, 0.0, 10.0, 110.0, rate_V_per_s, 0.5, 20.0)


def test_ranks_are_those_of_a_sorted_list_and_blocks_join_with_a_delay():
    reference, cell = BlockReference((0.0, 140.0), 0.1, 0.0), block().cell((0.0, 140.0))
    distances = np.geomspace(0.05, 0.2, 100)
    for distance_N in np.random.default_rng(2).permutation(distances).tolist():
        reference.add(cell, distance_N)
    assert reference.size == 100 - DELAY
    reference.forget_waiting()
    reference = BlockReference((0.0, 140.0), 0.1, 0.0)
    for distance_N in [*distances.tolist(), *[1.0] * DELAY]:
        reference.add(cell, distance_N)
    for distance_N in (0.04, 0.0811, 0.1234, 0.3):
        assert reference.rank(cell, distance_N) == np.count_nonzero(distances >= distance_N)
    assert reference.median_N(cell) == pytest.approx(0.1, rel=0.02)


def test_the_tolerance_is_a_share_of_the_distance():
    reference, cell = BlockReference((0.0, 140.0), 0.1, 0.25), block().cell((0.0, 140.0))
    for distance_N in [*np.linspace(0.1, 0.2, 101).tolist(), *[1.0] * DELAY]:
        reference.add(cell, distance_N)
    assert reference.rank(cell, 1.25 * 0.1503) in (50, 51)  # 50 are above 0.1503; steps are 0.5 % wide
    assert reference.rank(cell, 0.1503) in (80, 81)  # 0.1503 / 1.25 = 0.1202, 80 are above


def test_blocks_of_another_rate_are_another_kind_and_an_offset_counts_beyond_the_own_error():
    range_V = (0.0, 140.0)
    assert block().cell(range_V) == block(120.0).cell(range_V)
    assert block().cell(range_V) != block(1000.0).cell(range_V)
    assert block().distance_N(0.05, 0.1) == pytest.approx(0.1)
    assert block().distance_N(-0.3, 0.1) == pytest.approx(np.hypot(0.1, 0.2))
