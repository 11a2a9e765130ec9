"""Left-out losses of further columns: what the elimination says is what a fit of all columns together says."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.candidates.screening import Screening
from piezod.diagnose.hypothesis.fit import Normal, fit
from piezod.diagnose.hypothesis.gram import WITHIN, Eliminated
from tests.unit.diagnose.test_search import NOISE_N, RATE_HZ, worked


def coupled(force_N, u, role):
    if role == "recording":
        force_N[1:] += 0.004 * np.diff(u) * RATE_HZ
    return force_N


@pytest.fixture(scope="module")
def chain_and_point():
    chain, start = worked(np.random.default_rng(6), coupled)
    return chain, fit(chain, (), start).point


@pytest.fixture(scope="module")
def screening(chain_and_point):
    chain, point = chain_and_point
    return Screening(chain, (), point)


def rows_of(chain, point, columns):
    """Tangents, further columns and residual of all recordings [noise], and the number of each row's block."""
    normal = Normal.at(chain, (), point, robust=False)
    rows, blocks = [], []
    for number, series in enumerate(chain.series):
        scale = normal.trust[number][:, None] / series.noise_N
        rows.append(np.hstack((normal.jacobians[number], columns[number] * scale, normal.weighted[number][:, None])))
        for block in series.blocks:
            blocks += [len(set(blocks))] * len(range(*block.indices(series.time_s.size)[:2], 1))
    step = chain.rows[0].step
    assert step == 1
    return normal, np.concatenate(rows), np.array(blocks)


def test_a_loss_is_that_of_a_fit_of_tangents_and_columns_without_each_block(chain_and_point):
    chain, point = chain_and_point
    rng = np.random.default_rng(1)
    columns = [np.column_stack((np.sin(0.01 * s.command_V), rng.normal(size=s.time_s.size))) for s in chain.series]
    normal, rows, blocks = rows_of(chain, point, columns)
    ones = np.ones(len(chain.series))
    products = Eliminated.at(normal, columns, [ones])
    about = products.multiples([0, 1])
    parameters, further = normal.ridge.shape[0], np.arange(2)
    penalty = np.zeros((parameters + 2, parameters + 2))
    penalty[:parameters, :parameters] = normal.ridge + normal.layout.prior(chain, point)
    penalty[parameters + further, parameters + further] = (WITHIN * about) ** -2.0
    pull = np.concatenate((normal.pull, about / (WITHIN * about) ** 2))
    losses = []
    for block in range(blocks.max() + 1):
        kept, left = rows[blocks != block], rows[blocks == block]
        hessian = kept[:, :-1].T @ kept[:, :-1] + penalty
        scale = 1.0 / np.sqrt(np.diag(hessian))
        side = scale * (kept[:, :-1].T @ kept[:, -1] + pull)
        solution = scale * np.linalg.lstsq(hessian * np.outer(scale, scale), side, rcond=1e-15)[0]
        losses.append(np.sum((left[:, -1] - left[:, :-1] @ solution) ** 2))
    assert products.loss_with([0, 1], about) == pytest.approx(np.sum(losses) / len(rows), rel=1e-6)
    assert products.loss_with([0, 1], np.zeros(2)) == products.loss


def test_a_column_that_acts_in_one_recording_is_the_column_with_zeros_in_the_others(chain_and_point):
    chain, point = chain_and_point
    normal = Normal.at(chain, (), point, robust=False)
    columns = [np.sin(0.01 * s.command_V)[:, None] for s in chain.series]
    acts = np.array([float(series.role == "recording") for series in chain.series])
    masked = [column * acting for column, acting in zip(columns, acts, strict=True)]
    by_factor = Eliminated.at(normal, columns, [acts])
    by_zeros = Eliminated.at(normal, masked, [np.ones_like(acts)])
    np.testing.assert_allclose(by_factor.whole, by_zeros.whole, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(by_factor.left_out, by_zeros.left_out, rtol=1e-12, atol=1e-9)


def test_the_loss_of_the_hypothesis_is_that_of_its_fit(chain_and_point, screening):
    chain, point = chain_and_point
    fitted = fit(chain, (), point, most_steps=0, robust=False)
    assert screening.loss == pytest.approx(fitted.loss, rel=1e-9)


def test_the_best_promise_is_the_hidden_effect_and_is_kept_by_a_fit(chain_and_point, screening):
    chain, _ = chain_and_point
    best = screening.singles[0]
    assert (best.name, best.candidates[0].term.scope) == ("feedthrough", "since")
    assert best.candidates[0].values["coefficient_N_s_per_V"] == pytest.approx(0.004, rel=0.1)
    fitted = fit(chain, *screening.start(best), robust=False)
    assert fitted.loss == pytest.approx(best.loss, rel=0.1)


def test_no_start_is_worse_than_the_hypothesis_without_the_effect(chain_and_point, screening):
    chain, point = chain_and_point
    without = sum(
        float(np.sum(chain.series[k].residual(chain.rows[k], chain.compared(k, (), point))[0] ** 2))
        for k in range(len(chain.series))
    )
    terms, start = screening.start(screening.singles[0])
    squares = sum(
        float(np.sum(chain.series[k].residual(chain.rows[k], chain.compared(k, terms, start))[0] ** 2))
        for k in range(len(chain.series))
    )
    assert squares < without


def test_two_effects_that_hide_together_promise_more_as_a_pair():
    def both(force_N, u, role):
        force_N = coupled(force_N, u, role)
        return force_N if role == "identification" else force_N * np.linspace(1.0, 1.05, force_N.size)

    chain, start = worked(np.random.default_rng(7), both)
    screening = Screening(chain, (), fit(chain, (), start).point)
    best = screening.pairs[0]
    assert {candidate.term.effect.name for candidate in best.candidates} == {"feedthrough", "gain_drift"}
    assert best.loss < 0.7 * screening.singles[0].loss


def test_residuals_far_from_the_noise_count_as_they_are_where_a_fit_is_not_robust(chain_and_point):
    chain, point = chain_and_point
    strong = [
        replace(s, reading_N=s.reading_N + 50.0 * NOISE_N * (np.arange(s.time_s.size) % 997 == 0)) for s in chain.series
    ]
    other = chain.like(strong)
    plain = Normal.at(other, (), point, robust=False)
    assert all((weights == 1.0).all() for weights in plain.weights)
    assert plain.loss == pytest.approx(
        float(plain.blocks.square.sum()) + float(plain.stiff @ plain.layout.vector(point) ** 2)
    )
    assert any((weights < 1.0).any() for weights in Normal.at(other, (), point).weights)
