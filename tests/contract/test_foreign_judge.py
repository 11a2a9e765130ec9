"""A foreign simulation, written from the pages of effects and operators alone, agrees with `piezod simulate`."""

import pytest

from piezod.effects import EFFECTS
from tests.foreign_judge.cases import CASES, differences

AGREES = 1e-6  # largest difference [range]


def test_the_judge_knows_every_effect():
    assert set(CASES) == set(EFFECTS)


@pytest.mark.parametrize("name", CASES)
def test_the_pages_alone_give_what_piezod_simulates_at_every_hold(name):
    assert max(differences(name)) < AGREES
