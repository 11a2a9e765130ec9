"""Corners in the base: followed where a stack has them, and none where it has none; a name is no corner."""

import numpy as np
import pytest

from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.corners import with_corners
from piezod.diagnose.selection.search import search
from tests.unit.diagnose.residuals import mixed_work, noise, played, series, time, triangles

SAMPLES = 20_000
NOISE_N = 0.05
WIDTHS_V, LEAST_V, KINK_V = (6.0, 17.0, 33.0), 0.3, 40.0


def few_plays(u):
    """Three plays in front of a law that stiffens at a voltage, from rest."""
    stroke = 0.7 * u + sum(0.1 * played(np.concatenate(([0.0], u)), width)[1:] for width in WIDTHS_V)
    return 1.8 * stroke + 0.4 * np.maximum(stroke - KINK_V, 0.0)


def many_plays(u):
    """Sixty plays with a density that falls, from rest."""
    widths = np.linspace(0.5, 59.5, 60)
    parts = 0.3 * np.exp(-widths / 30.0) / np.exp(-widths / 30.0).sum()
    return 1.8 * (
        0.7 * u + sum(p * played(np.concatenate(([0.0], u)), w)[1:] for w, p in zip(widths, parts, strict=True))
    )


def chain_over(stack, missing=lambda force_N: force_N):
    rng, made = np.random.default_rng(4), []
    for role, drive in (("identification", triangles), ("recording", mixed_work)):
        seconds = time(SAMPLES)
        u = drive(seconds) if role == "identification" else drive(seconds) - drive(seconds)[0]
        u = np.clip(120.0 - u, 0.0, None) if role == "identification" else np.clip(u, 0.0, None)
        force_N = stack(u) if role == "identification" else missing(stack(u))
        made.append(series(seconds, u, force_N + NOISE_N * noise(SAMPLES, 0.0, rng), NOISE_N, role=role))
    chain = Chain(made, PlayDensity.up_to(59.7), ForceLaw(-4.0, 120.0), 216.0)
    return chain, empty_point(chain, 1.8, 0.0)


@pytest.mark.parametrize("by_all", [False, True])
def test_a_stack_of_few_plays_behind_a_kink_is_followed_down_to_the_noise(by_all):
    chain, start = chain_over(few_plays)
    smooth = fit(chain, (), start)
    assert smooth.loss > 1.5
    found = with_corners(chain, smooth, by_all=by_all)
    assert found is not None
    sharp, fitted = found
    assert fitted.loss == pytest.approx(1.0, abs=0.05)
    own = sharp.density.hats[:, -1] != 0.0
    for width_V in WIDTHS_V:
        assert np.abs(sharp.density.thresholds_V[own] - width_V).min() < LEAST_V
    assert np.abs(sharp.law.kinks_V - KINK_V).min() < LEAST_V


@pytest.mark.parametrize("by_all", [False, True])
def test_a_smooth_stack_needs_no_corner(by_all):
    chain, start = chain_over(many_plays)
    smooth = fit(chain, (), start)
    found = with_corners(chain, smooth, by_all=by_all)
    assert found is None or found[1].loss > RULES.better * smooth.loss


def bent(per_N):
    chain, start = chain_over(few_plays, lambda force_N: force_N + per_N * force_N**2)
    return search(chain, start, lambda *_: None)


@pytest.mark.slow
def test_what_corners_explain_gets_no_name_and_what_they_do_not_keeps_its_own():
    assert search(*chain_over(few_plays), lambda *_: None).names == ()
    found = bent(1.5e-4)
    assert found.names == ("output_nonlinearity",)
    assert found.hypothesis.loss < 1.1


@pytest.mark.slow
def test_a_bend_that_another_gain_explains_within_two_percent_is_told_as_that():
    found = bent(1e-4)
    assert found.names == ("gain",)
    assert found.hypothesis.loss < 1.02


@pytest.mark.parametrize("by_all", [False, True])
def test_plays_alone_bring_no_kink(by_all):
    chain, start = chain_over(lambda u: 0.7 * u + 0.9 * played(np.concatenate(([0.0], u)), 17.0)[1:])
    found = with_corners(chain, fit(chain, (), start), by_all=by_all)
    assert found is not None
    assert found[0].law.kinks_V.size == 0
    assert found[1].loss == pytest.approx(1.0, abs=0.05)
