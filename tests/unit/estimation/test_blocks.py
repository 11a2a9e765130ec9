"""Sums by block: what they say of a fit without a block is what a fit to the rows of the others gives."""

import numpy as np
import pytest

from piezod.estimation.fit.blocks import Blocks, solved, spread

PARTS = [slice(0, 30), slice(30, 70), slice(70, 100)]
PENALTY, PULL = np.diag([0.3, 0.0, 2.0, 0.1]), np.array([0.2, 0.0, -1.0, 0.5])


@pytest.fixture
def rows():
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(100, 4)) * [1.0, 100.0, 1e-3, 5.0]
    return columns, columns @ [1.0, 0.02, 400.0, -3.0] + rng.normal(size=100)


def refitted(columns, target, left_out):
    kept = np.delete(np.arange(target.shape[0]), left_out)
    gram = columns[kept].T @ columns[kept] + PENALTY
    return np.linalg.solve(gram, (columns[kept].T @ target[kept] + PULL.reshape(4, *[1] * (target.ndim - 1))))


def test_a_fit_without_a_block_is_the_fit_to_the_rows_of_the_others(rows):
    columns, target = rows
    sums = Blocks.of(columns, target, PARTS)
    for part, own, error in zip(
        PARTS, sums.without(PENALTY, PULL), sums.errors(sums.without(PENALTY, PULL)), strict=True
    ):
        expected = refitted(columns, target, np.arange(100)[part])
        np.testing.assert_allclose(own, expected, rtol=1e-9)
        np.testing.assert_allclose(error, np.sum((target[part] - columns[part] @ expected) ** 2), rtol=1e-9)


def test_several_targets_have_the_products_of_their_errors(rows):
    columns, target = rows
    targets = np.column_stack((target, np.roll(target, 7), target**2))
    sums = Blocks.of(columns, targets, PARTS)
    products = sums.errors(sums.without(PENALTY, PULL[:, None]))
    for part, own in zip(PARTS, products, strict=True):
        left = targets[part] - columns[part] @ refitted(columns, targets, np.arange(100)[part])
        np.testing.assert_allclose(own, left.T @ left, rtol=1e-9)


def test_targets_lose_what_the_columns_follow_of_them(rows):
    columns, target = rows
    targets = np.column_stack((target, np.roll(target, 7)))
    sums, nothing = Blocks.of(columns, targets, PARTS), Blocks.of(columns, targets[:, :0], PARTS)
    kept = np.arange(30, 100)
    for rows_of_fit, products in ((np.arange(100), sums.left(sums.solve())), (kept, sums.left(sums.without())[0])):
        used = columns[rows_of_fit]
        left = targets[rows_of_fit] - used @ np.linalg.lstsq(used, targets[rows_of_fit], rcond=None)[0]
        np.testing.assert_allclose(products, left.T @ left, rtol=1e-8)
    assert nothing.left(nothing.without()).shape == (3, 0, 0)


def test_a_held_parameter_keeps_its_value_and_the_others_are_fitted_beside_it(rows):
    columns, target = rows
    held = np.array([np.nan, np.nan, 300.0, np.nan])
    fitted = solved(columns.T @ columns, columns.T @ target, held)
    others = np.delete(columns, 2, axis=1)
    expected = np.linalg.lstsq(others, target - 300.0 * columns[:, 2], rcond=None)[0]
    np.testing.assert_allclose(fitted, np.insert(expected, 2, 300.0), rtol=1e-9)


def test_folds_and_recordings_keep_the_sums_and_the_samples(rows):
    columns, target = rows
    joined = Blocks.all_of([Blocks.of(columns, target, PARTS[:2]), Blocks.of(columns, target, PARTS[2:])])
    folds = joined.folded(np.array([0, 1, 0]))
    np.testing.assert_array_equal(folds.samples, [60.0, 40.0])
    for known, both in zip(joined.total, folds.total, strict=True):
        np.testing.assert_allclose(known, both, rtol=1e-12)
    np.testing.assert_allclose(folds.without()[0], joined.solve([0, 2]), rtol=1e-9)


def test_dependent_columns_share_their_size_and_an_empty_column_stays_at_zero(rows):
    columns, target = rows
    twice = np.column_stack((columns[:, 0], columns[:, 0], np.zeros(100)))
    sizes = solved(twice.T @ twice, twice.T @ target)
    np.testing.assert_allclose(sizes[0], sizes[1], rtol=1e-2)
    np.testing.assert_allclose(sizes[0] + sizes[1], columns[:, 0] @ target / (columns[:, 0] @ columns[:, 0]), rtol=1e-6)
    assert sizes[2] == 0.0


def test_the_spread_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(1).normal(size=40)
    without = (values.sum() - values)[:, None] / 39
    np.testing.assert_allclose(spread(without), [[values.var(ddof=1) / 40]], rtol=1e-9)
