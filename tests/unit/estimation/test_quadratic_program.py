"""The quadratic programs: rows that constrain nothing."""

import numpy as np
import pytest

from piezod.estimation.fit.quadratic_program import Constraints, solve_step


def test_a_row_of_nothing_constrains_nothing():
    hessian, gradient = np.diag([2.0, 1.0, 4.0]), np.array([1.0, -3.0, 2.0])
    start = np.array([1.0, 1.0, 1.0])
    kept = Constraints(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]), np.array([0.0, 0.0, -1.0]), None)
    with np.errstate(all="raise"):
        slopes = solve_step(hessian, gradient, kept, start)
    assert slopes == pytest.approx([1.5, 0.0, 1.5])  # the second would go to -2
