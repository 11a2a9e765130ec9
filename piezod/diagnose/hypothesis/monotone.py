"""Refit of a hypothesis with a monotone loading curve, as a stack has it.

Each damped Gauss-Newton step is a quadratic program in which every slope of the loading curve stays positive.
"""

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import DONE, FIRST_DAMPING, MOST_DAMPING, Fitted, Normal
from piezod.diagnose.hypothesis.layout import Layout
from piezod.errors import RecordingError
from piezod.estimation.fit.quadratic_program import Constraints, solve_step
from piezod.operators import EPS

STEPS = 80
SMALLEST_SLOPE = 5.0 * EPS  # of the loading curve [1]


def loading_slopes(chain: Chain, density: Array) -> Array:
    """Slopes of the loading curve, shape (1 + plays,) [1]; the curve has an inverse where all are positive."""
    return np.cumsum(chain.density.weights(density))


def is_monotone(chain: Chain, fitted: Fitted) -> bool:
    """Whether the loading curve rises everywhere."""
    return bool(loading_slopes(chain, fitted.point.density).min() >= EPS)


def monotone_fit(chain: Chain, fitted: Fitted) -> Fitted:
    """Hypothesis refitted with a monotone loading curve; unchanged where it is monotone or no fit is found."""
    if is_monotone(chain, fitted):
        return fitted
    layout = Layout(chain, fitted.terms)
    constraints = _rising(chain, layout)
    normal, vector, damping = Normal.at(chain, fitted.terms, fitted.point), layout.vector(fitted.point), FIRST_DAMPING
    least = np.inf  # the first step makes the curve monotone at any cost
    for _ in range(STEPS):
        trial = _trial(normal, constraints, vector, damping)
        beyond = np.inf if trial is None else normal.loss_at(layout.point(trial, fitted.point))
        if trial is None or beyond >= least:
            damping *= 10.0
            if damping > MOST_DAMPING:
                break
            continue
        fell = np.inf if np.isinf(least) else (least - beyond) / least
        vector, damping = trial, 0.1 * damping
        normal = Normal.at(chain, fitted.terms, layout.point(vector, fitted.point))
        least = normal.loss
        if fell < DONE:
            break
    return normal.fitted() if np.isfinite(least) else fitted


def _rising(chain: Chain, layout: Layout) -> Constraints:
    """Constraints of the vector: every slope of the loading curve is at least `SMALLEST_SLOPE`."""
    count = chain.density.count
    at_zero = loading_slopes(chain, np.zeros(count))
    rows = np.zeros((at_zero.size, layout.size))
    rows[:, :count] = np.array([loading_slopes(chain, unit) - at_zero for unit in np.eye(count)]).T
    return Constraints(rows, SMALLEST_SLOPE - at_zero)


def _trial(normal: Normal, constraints: Constraints, vector: Array, damping: float) -> Array | None:
    """Vector after a damped step within the constraints; None where the program is too ill-conditioned."""
    hessian, gradient = normal.total
    try:
        return normal.layout.clipped(
            solve_step(hessian + damping * np.diag(np.diag(hessian)), gradient, constraints, vector)
        )
    except RecordingError:
        return None
