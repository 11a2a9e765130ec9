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


@pytest.mark.parametrize("equality", [None, np.full(15, 1.0 / 15.0)])
def test_equal_programs_have_equal_bits_wherever_the_memory_lies(equality):
    """ProxQP alone has two results here, and in a direction of little curvature they differ by percents."""
    rng, kept = np.random.default_rng(2), []
    columns = rng.normal(size=(400, 15))
    columns[:, 5:] = columns[:, rng.integers(0, 5, 10)] + 1e-3 * rng.normal(size=(400, 10))
    hessian, gradient = columns.T @ columns, columns.T @ rng.normal(size=400)
    constraints = Constraints(np.cumsum(np.eye(15), axis=0), np.full(15, 1e-3), equality)
    steps = []
    for k in range(60):
        kept = [*kept[-5:], np.random.default_rng(k).normal(size=rng.integers(1, 3000))]  # memory of other content
        steps.append(solve_step(hessian, gradient, constraints, np.ones(15)))
    assert all(np.array_equal(step, steps[0]) for step in steps)


def test_the_solution_meets_the_conditions_of_an_optimum():
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(100, 12))
    hessian, gradient = columns.T @ columns, columns.T @ rng.normal(size=100)
    constraints = Constraints(np.eye(12), np.ones(12))
    slopes = solve_step(hessian, gradient, constraints, np.ones(12))
    slope_of_cost = hessian @ (slopes - 1.0) - gradient
    free = slopes > 1.0 + 1e-8
    assert 0 < np.count_nonzero(free) < 12
    np.testing.assert_allclose(slope_of_cost[free], 0.0, atol=1e-8 * np.abs(gradient).max())
    assert (slope_of_cost[~free] > 0.0).all()


def test_a_parameter_without_curvature_stays_where_it_is():
    hessian, gradient = np.diag([2.0, 0.0, 1.0]), np.array([1.0, 0.0, -3.0])
    slopes = solve_step(hessian, gradient, Constraints(np.eye(3), np.zeros(3)), np.ones(3))
    np.testing.assert_allclose(slopes, [1.5, 1.0, 0.0], atol=1e-9)
