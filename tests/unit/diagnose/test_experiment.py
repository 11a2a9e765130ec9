"""The next experiment: within the range and slews of the recordings, and as good as it promises."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.experiment.isolability import isolability
from piezod.diagnose.experiment.planning import _slewed, next_experiment
from piezod.estimation.recordings.sources import Source
from piezod.recording import Recording
from tests.unit.diagnose.test_isolability import slow_sine, source, stack  # noqa: F401

LONGEST_S = 40.0


@pytest.fixture(scope="module")
def planned(stack):  # noqa: F811
    asked = [source(stack, slow_sine(), 100.0)]
    before = isolability(stack, asked, [])
    return asked, before, next_experiment(stack, asked, [], before, LONGEST_S)


def test_the_drive_stays_within_range_slews_and_time(planned):
    (asked,), _, found = planned
    u, given = found.voltage_V, asked.recording.channel("voltage_V")
    assert given.min() - 1e-9 <= u.min()
    assert u.max() <= given.max() + 1e-9
    assert np.abs(np.diff(u)).max() <= np.abs(np.diff(given)).max() * (1.0 + 1e-9)
    assert u.size * found.dt_s <= LONGEST_S
    assert u[-1] == given.min()
    rise = u[: int(np.flatnonzero(np.diff(u) < 0.0)[0]) + 1]
    assert rise[-1] >= given.min() + 0.98 * np.ptp(given) - 1e-9, "it begins with a rise over the range"
    assert found.recording("voltage_V").uniform


def test_every_open_pair_is_separated_further(planned):
    _, before, found = planned
    assert list(found.pairs) == before.pairs()
    assert all(after < pair.size for pair, after in zip(found.pairs, found.sizes, strict=True))


def test_an_answer_with_other_noise_separates_within_a_factor_of_two_of_the_promise(planned, stack):  # noqa: F811
    asked, _, found = planned
    drive = found.voltage_V
    force_N = stack.operator().run(drive) + np.random.default_rng(77).normal(0.0, 0.1, drive.size)
    answer = Recording(np.arange(drive.size) * found.dt_s, {"voltage_V": drive, "force_N": force_N}, {}, "answer")
    after = isolability(stack, [*asked, Source(answer, "answer", "recording")], [])
    for pair, promised in zip(found.pairs, found.sizes, strict=True):
        places = after.effects.index(pair.first), after.effects.index(pair.second)
        reached = max(after.separated_from[places], after.separated_from[places[::-1]])
        assert 0.5 < reached / promised < 2.0, pair


def test_only_wanted_pairs_are_separated(planned, stack):  # noqa: F811
    asked, before, found = planned
    wanted = (found.pairs[-1].first, found.pairs[-1].second)
    (pair,) = next_experiment(stack, asked, [], before, LONGEST_S, [wanted, ("creep", "gremlins")]).pairs
    assert pair == found.pairs[-1]
    assert next_experiment(stack, asked, [], before, LONGEST_S, [("creep", "gremlins")]) is None


def test_where_no_pair_is_open_nothing_is_planned(planned, stack):  # noqa: F811
    asked, before, _ = planned
    settled = replace(before, separated_from=np.zeros_like(before.separated_from))
    assert next_experiment(stack, asked, [], settled, LONGEST_S) is None


def test_a_slewed_drive_reaches_its_levels_and_comes_back():
    drive = _slewed(np.repeat([10.0, 0.0, 10.0], 50), 0.0, 1.0)
    assert drive[40] == 10.0
    assert drive[-1] == 0.0
    assert np.abs(np.diff(drive)).max() == 1.0
