"""The section `information`: the root of an information matrix, and its marginals."""

import numpy as np
import pytest
from pydantic import ValidationError

from piezod.model.information import Information, marginal, packed

RNG = np.random.default_rng(4)
COLUMNS = RNG.normal(size=(50, 5)) * np.array([1e-3, 1.0, 20.0, 5e4, 1.0])
MATRIX = COLUMNS.T @ COLUMNS


def information(names=("density.0", "law.0"), estimate=(1.0, 2.0), root=((1.0, 0.5), (2.0,)), **changes):
    content = {
        "recordings": ("0" * 64,),
        "driven": (0.0, 100.0),
        "noise": 0.1,
        "gain": (0.9, 1.1),
        "loop_width_percent": (5.0, 6.0),
        "reach": 99.5,
        "law_range": (-3.0, 100.0),
        "names": names,
        "estimate": estimate,
        "root": root,
    }
    return Information(**{**content, **changes})


def test_the_matrix_is_the_square_of_its_root():
    np.testing.assert_array_equal(information().matrix, [[1.0, 0.5], [0.5, 4.25]])


def test_a_matrix_that_is_packed_and_squared_again_is_the_same():
    names = tuple(f"law.{k}" for k in range(5))
    again = information(names, (0.0,) * 5, packed(MATRIX)).matrix
    scale = np.sqrt(np.diag(MATRIX))
    np.testing.assert_allclose(again / np.outer(scale, scale), MATRIX / np.outer(scale, scale), atol=1e-7)


def test_a_direction_without_information_is_packed_with_hardly_any():
    singular = MATRIX.copy()
    singular[:, 4] = singular[4, :] = 0.0
    assert packed(singular)[4][0] < 1e-100
    parallel = np.ones((2, 2))
    assert packed(parallel)[1][0] < 1e-6


def test_the_inverse_of_a_marginal_is_the_block_of_the_inverse():
    places = np.array([1, 3])
    expected = np.linalg.inv(MATRIX)[np.ix_(places, places)]
    np.testing.assert_allclose(np.linalg.inv(marginal(MATRIX, places)), expected, rtol=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {"estimate": (1.0,)},
        {"root": ((1.0, 0.5),)},
        {"root": ((1.0,), (2.0,))},
        {"names": ("law.0", "law.0")},
        {"noise": 0.0},
    ],
)
def test_rows_that_do_not_agree_are_refused(changes):
    with pytest.raises(ValidationError):
        information(**changes)
