"""A hypothesis whose refitted plays fold, fitted again so that they do not: a stack's loading curve only rises.

The damped Gauss-Newton steps of `fit`, each a quadratic program in which every slope of the loading curve stays
positive.
"""

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import DONE, FIRST_DAMPING, MOST_DAMPING, Fitted, Normal
from piezod.diagnose.hypothesis.layout import Layout
from piezod.errors import RecordingError
from piezod.estimation.quadratic_program import Constraints, solve_step
from piezod.operators import EPS

Array = NDArray[np.float64]

STEPS = 80
SMALLEST = 5.0 * EPS  # slope of the loading curve


def loading_slopes(chain: Chain, density: Array) -> Array:
    """Slopes of the loading curve, shape (1 + plays,) [1]; where one is not positive it folds and has no inverse."""
    return np.cumsum(chain.density.weights(density))


def rises(chain: Chain, found: Fitted) -> bool:
    """Whether the loading curve rises everywhere."""
    return bool(loading_slopes(chain, found.point.density).min() >= EPS)


def unfolded(chain: Chain, found: Fitted) -> Fitted:
    """The same hypothesis, fitted where its plays do not fold; itself where they do not, or where no fit is found."""
    if rises(chain, found):
        return found
    layout = Layout(chain, found.terms)
    constraints = _rising(chain, layout)
    normal, vector, damping = Normal.at(chain, found.terms, found.point), layout.vector(found.point), FIRST_DAMPING
    least = np.inf  # the first step leaves what folds, whatever that costs
    for _ in range(STEPS):
        trial = _trial(normal, constraints, vector, damping)
        beyond = np.inf if trial is None else normal.loss_at(layout.point(trial, found.point))
        if trial is None or beyond >= least:
            damping *= 10.0
            if damping > MOST_DAMPING:
                break
            continue
        fell = np.inf if np.isinf(least) else (least - beyond) / least
        vector, damping = trial, 0.1 * damping
        normal = Normal.at(chain, found.terms, layout.point(vector, found.point))
        least = normal.loss
        if fell < DONE:
            break
    return normal.fitted(normal.point) if np.isfinite(least) else found


def _rising(chain: Chain, layout: Layout) -> Constraints:
    """Every slope of the loading curve at least the smallest, in what a hypothesis fits."""
    count = chain.density.count
    at_zero = loading_slopes(chain, np.zeros(count))
    rows = np.zeros((at_zero.size, layout.size))
    rows[:, :count] = np.array([loading_slopes(chain, one) - at_zero for one in np.eye(count)]).T
    return Constraints(rows, SMALLEST - at_zero)


def _trial(normal: Normal, constraints: Constraints, vector: Array, damping: float) -> Array | None:
    """Where a damped step within the constraints ends; None where it is too ill-conditioned to be solved."""
    hessian, gradient = normal.hessian.sum(axis=0) + normal.ridge, normal.gradient.sum(axis=0) + normal.pull
    hessian += damping * np.diag(np.diag(hessian))
    try:
        return normal.layout.clipped(solve_step(hessian, gradient, constraints, vector))
    except RecordingError:
        return None
