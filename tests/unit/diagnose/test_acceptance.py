"""Which gains are believed, on losses of blocks made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.candidates.steps import NEVER_S
from piezod.diagnose.hypothesis.basis import HATS, SPLINES, ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.selection.acceptance import degenerate, steadiness, steady_enough, worth
from piezod.effects import EFFECTS
from tests.unit.diagnose.residuals import mixed_work, noise, series, time

BLOCKS = 30


def fitted(losses, effect=None):
    terms = () if effect is None else (Term(EFFECTS[effect], "since"),)
    point = Point(np.zeros(HATS), np.zeros(SPLINES), np.zeros(2), tuple({} for _ in terms))
    losses = np.asarray(losses, float)
    return Fitted(terms, point, losses, losses, np.full(BLOCKS, 100.0), tuple({} for _ in terms))


def with_gain(gains):
    """One everywhere, then lower by e^-gain."""
    return np.exp(-np.asarray(gains, float))


def test_a_gain_in_every_block_is_worth_naming_and_one_by_chance_is_not():
    rng = np.random.default_rng(2)
    before = fitted(np.ones(BLOCKS))
    assert worth(before, fitted(with_gain(0.1 + 0.05 * rng.standard_normal(BLOCKS)), "creep"))
    assert not worth(before, fitted(with_gain(0.3 * rng.standard_normal(BLOCKS) - 0.02), "creep"))


@pytest.mark.parametrize(
    ("blocks", "gain", "taken"), [(30, 0.1, True), (30, 0.05, False), (2, 3.0, True), (2, 1.0, False)]
)
def test_a_gain_in_few_blocks_must_be_larger_than_one_in_all(blocks, gain, taken):
    """By hand: in all of 30 blocks steadiness is sqrt(30), and the least gain 0.22 exp(-5.48 / 5) = 0.074."""
    gains = np.zeros(BLOCKS)
    gains[:blocks] = gain
    after = fitted(np.ones(BLOCKS), "contact_gap")
    assert worth(fitted(np.exp(gains)), after) == taken


@pytest.mark.parametrize(
    ("effect", "blocks", "steady"), [("creep", 6, False), ("creep", 12, True), ("resonance", 6, True)]
)
def test_what_bends_to_anything_must_gain_in_more_than_nine_blocks(effect, blocks, steady):
    """By hand: in n blocks that gain alike steadiness is sqrt(n), and 3 is reached by nine."""
    gains = np.zeros(BLOCKS)
    gains[:blocks] = 1.0
    assert steady_enough(fitted(np.exp(gains)), fitted(np.ones(BLOCKS), effect)) == steady


def test_a_block_without_readings_says_nothing_of_a_gain():
    samples = np.where(np.arange(BLOCKS) < 4, 0.0, 100.0)
    empty = np.where(samples > 0, 1.0, np.inf)
    before, after = (replace(fitted(empty * loss, "creep"), samples=samples) for loss in (1.1, 1.0))
    with np.errstate(all="raise"):
        assert steadiness(before, after) == pytest.approx(np.sqrt(BLOCKS - 4))


def test_a_block_that_neither_hypothesis_predicts_from_the_others_counts_as_it_fits():
    ones, lost, less_lost = np.ones((3, BLOCKS))
    lost[5], less_lost[5] = 2000.0, 1400.0
    before, after, known = (
        replace(fitted(losses, effect), in_fit=ones)
        for losses, effect in ((lost, None), (less_lost, "creep"), (ones, "creep"))
    )
    assert not worth(before, after)
    assert worth(before, known), "one that does predict it is an effect"


def test_steadiness_is_the_sign_test_of_equal_gains():
    before = fitted(np.ones(BLOCKS))
    assert steadiness(before, fitted(with_gain(np.full(BLOCKS, 0.2)), "creep")) == pytest.approx(np.sqrt(BLOCKS))
    half = np.where(np.arange(BLOCKS) % 2 == 0, 0.2, -0.2)
    assert steadiness(before, fitted(with_gain(half), "creep")) == pytest.approx(0.0)


def is_believed_step(on_s, off_s, past_ends_s=None):
    """Whether a step of the readings at these times is taken for a step of the load."""
    time_s = time(20_000)
    u = mixed_work(time_s)
    residual_N = noise(time_s.size, 0.0, np.random.default_rng(1)) + 5.0 * ((time_s >= on_s) & (time_s < off_s))
    recorded = series(time_s, u, residual_N)
    if past_ends_s is not None:
        recorded = replace(recorded, start_columns=(time_s >= past_ends_s)[:, None].astype(float))
    chain = Chain([recorded], PlayDensity.up_to(60.0), ForceLaw(-5.0, 125.0), 100.0)
    values = {"step_N": 5.0, "on_s": on_s, "off_s": off_s, "rise_s": 0.0}
    flat = replace(empty_point(chain, 1.0, 0.0), values=(values,))
    flat = replace(flat, law=np.zeros_like(flat.law))
    term = Term(EFFECTS["load_step"], "once", 0)
    readings = chain.run(0, (), replace(flat, values=())).reading_N
    there = replace(recorded, reading_N=readings + residual_N)
    step = Fitted((term,), flat, np.ones(BLOCKS), np.ones(BLOCKS), np.full(BLOCKS, 100.0), ({},))
    return not degenerate(chain.like([there]), step)


@pytest.mark.parametrize(
    ("on_s", "off_s", "is_one"),
    [(7.3, NEVER_S, True), (0.2, NEVER_S, False), (0.1, 0.3, False), (0.2, 7.3, True), (19.9, NEVER_S, True)],
)
def test_a_step_soon_after_the_begin_is_what_an_unknown_start_leaves(on_s, off_s, is_one):
    assert is_believed_step(on_s, off_s) == is_one


@pytest.mark.parametrize(("past_ends_s", "is_one"), [(7.3, False), (7.1, False), (12.0, True), (3.0, True)])
def test_a_step_where_the_command_leaves_the_range_swept_before_is_what_an_unknown_start_leaves(past_ends_s, is_one):
    assert is_believed_step(7.3, NEVER_S, past_ends_s) == is_one
