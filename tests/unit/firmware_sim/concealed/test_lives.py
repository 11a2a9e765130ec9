"""Lives of concealed benches."""

import numpy as np
import pytest

from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.lives import FACTOR, GAINS, Life, draw_life

FAMILY = "plays"


def drawn(change: str) -> Life:
    return draw_life(FAMILY, change, np.random.SeedSequence((7, 1)))


@pytest.mark.parametrize(("change", "factor"), [("grows", FACTOR), ("shrinks", 1.0 / FACTOR)])
def test_only_the_scale_of_the_changed_effect_differs_between_the_third_and_the_fourth_recording(
    change: str, factor: float
) -> None:
    life = drawn(change)
    scale = ENTRIES[life.effect].scale
    before, after = life.hidden[life.effect].parameters, life.since[life.effect].parameters
    assert after == before | {scale: factor * before[scale]}
    assert {name: on for name, on in life.since.items() if name != life.effect} == {
        name: on for name, on in life.hidden.items() if name != life.effect
    }


@pytest.mark.parametrize(("change", "gone", "come"), [("gone", 1, 0), ("new", 0, 1), ("none", 0, 0)])
def test_an_effect_goes_or_comes_once(change: str, gone: int, come: int) -> None:
    life = drawn(change)
    assert len(set(life.hidden) - set(life.since)) == gone
    assert len(set(life.since) - set(life.hidden)) == come


def test_a_lower_gain_scales_every_reading_alike() -> None:
    life = drawn("gain")
    before, after = life.steps[2].case.plant, life.steps[3].case.plant
    drive = life.steps[3].record.drive
    ratio = after.reading_N(drive, {}, 1)[1000:] / before.reading_N(drive, {}, 1)[1000:]
    assert GAINS[0] <= ratio[0] <= GAINS[1]
    assert np.allclose(ratio, ratio[0], rtol=1e-9)


def test_no_hidden_effect_acts_in_the_identification() -> None:
    life = drawn("grows")
    assert life.steps[0].case.active(life.steps[0].record) == {}
    assert set(life.steps[1].case.active(life.steps[1].record)) == set(life.hidden)
