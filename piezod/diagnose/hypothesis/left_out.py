"""Errors of estimates and the significance of gains, from fits without one block after the other."""

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.rules import RULES
from piezod.effects.parameter import Parameter
from piezod.estimation.fit.blocks import spread

INTERVAL_FACTOR, FORM_ERROR = 2.0, 0.015
"""Factor on the errors that left-out blocks give, and relative error of the effect's form, added in squares.
Of 24 parameters of 33 concealed benches, 13 lay in the intervals of the blocks alone, and 21 in these."""
FLIPS = 20_000  # draws of random signs; the smallest p-value is 1 / (FLIPS + 1)


def covariance(moves: Array, form_errors: Array) -> Array:
    """Covariance of some parameters, shape (P, P).

    Parameters
    ----------
    moves
        Their changes when a block is left out, shape (B, P).
    form_errors
        Error of each by the form of its effect, which blocks do not show, shape (P,).
    """
    result: Array = INTERVAL_FACTOR**2 * spread(moves) + np.diag(form_errors**2)
    return result


def form_error(parameter: Parameter, value: float) -> float:
    """Error by the form of the effect, on the scale that is fitted."""
    return FORM_ERROR * (1.0 if parameter.search.logarithmic else abs(value))


def sign_test_p(gains: Array) -> float:
    """Probability that the sum of the gains of the blocks, shape (B,), is as large with random signs.

    The gain of a single block is limited to `RULES.largest_share` median gains.
    """
    if gains.size < 2:
        return 1.0
    most = RULES.largest_share * float(np.median(np.abs(gains)))
    gains = np.clip(gains, -most, most)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (FLIPS, gains.size))
    return float((1 + np.count_nonzero(signs @ gains >= gains.sum() - 1e-12)) / (FLIPS + 1))
