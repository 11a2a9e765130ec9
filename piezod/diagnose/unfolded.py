"""A hypothesis whose refitted plays fold, fitted again so that they do not: a stack's loading curve only rises.

The Gauss-Newton steps of `fit`, each a quadratic program in which every slope of the loading curve stays positive.
"""

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.chain import Chain
from piezod.diagnose.fit import Fitted, Layout, Normal
from piezod.errors import RecordingError
from piezod.identify.qp import Constraints, solve_step
from piezod.operators import EPS

Array = NDArray[np.float64]

STEPS = 8
SMALLEST = 5.0 * EPS  # slope of the loading curve


def loading_slopes(chain: Chain, density: Array) -> Array:
    """Slopes of the loading curve, shape (1 + plays,) [1]; where one is not positive it folds and has no inverse."""
    return np.cumsum(chain.density.weights(density))


def unfolded(chain: Chain, found: Fitted) -> Fitted:
    """The same hypothesis, fitted where its plays do not fold; itself where they do not, or where no fit is found."""
    if loading_slopes(chain, found.point.density).min() >= EPS:
        return found
    layout, count = Layout(chain, found.terms), chain.density.count
    at_zero = loading_slopes(chain, np.zeros(count))
    by_hat = np.array([loading_slopes(chain, one) - at_zero for one in np.eye(count)]).T
    rows = np.zeros((at_zero.size, layout.size))
    rows[:, :count] = by_hat
    constraints = Constraints(rows, SMALLEST - at_zero)
    vector, least = layout.vector(found.point), np.inf
    best: Array = vector
    for _ in range(STEPS):
        normal = Normal.at(chain, found.terms, layout.point(vector, found.point))
        hessian, gradient = normal.hessian.sum(axis=0) + normal.ridge, normal.gradient.sum(axis=0) + normal.pull
        try:
            vector = layout.clipped(solve_step(hessian, gradient, constraints, vector))
        except RecordingError:
            break
        loss = normal.loss_at(layout.point(vector, found.point))
        if loss < least:
            best, least = vector, loss
        else:
            vector = 0.5 * (vector + best)
    if not np.isfinite(least):
        return found
    point = layout.point(best, found.point)
    return Normal.at(chain, found.terms, point).fitted(point)
