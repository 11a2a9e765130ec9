"""The analytic inverse of the Prandtl-Ishlinskii operator, to compare the implicit inverse with.

It is an operator of the same kind with the order exchanged, u = H'[S'[y - offset]] (3.9). Its plays move with its own
output, so it is exact only as long as the plant receives exactly that output.
Source: piezod/operators/README.md, "Analytic inverse", equations 3.28 to 3.36.
"""

import numpy as np

from piezod.operators.dead_zone import dead_zone_step, inverse_dead_zone
from piezod.operators.play import inverse_table, play_step
from piezod.operators.prandtl_ishlinskii import HEADER


def inverse_states(weights, states):
    """States of the inverse plays: z'_i = W_i z_i + sum_{j>i} w_j z_j (3.34), shape (n + 1,)."""
    products = weights * states
    return np.cumsum(weights) * states + np.concatenate((np.cumsum(products[::-1])[::-1][1:], [0.0]))


class AnalyticInverse:
    """The inverse tables of `operator`, from its present states."""

    def __init__(self, operator):
        plays, zones = inverse_table(*operator.plays), inverse_dead_zone(*operator.dead_zones)
        states = inverse_states(operator.plays[1], operator.states)
        self.offset, self.counts = operator.offset, (plays[0].size, zones[0].size)
        self.packed = np.concatenate((np.zeros(HEADER), *plays, states, *zones))

    def step(self, y):
        """Advance by one sample and return the input at which the operator's output is `y`."""
        plays, zones = self.counts
        v = dead_zone_step(self.packed, HEADER + 3 * plays, zones, y - self.offset)
        return play_step(self.packed, HEADER, plays, v)
