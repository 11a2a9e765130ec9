"""Corners in the base: single plays and kinks of the force law, in addition to the smooth density and spline.

A stack of few plays or few dead zones has corners, which no smooth density and no spline follows. Their residual
resembles friction or a rate dependence. Corners are chosen one after the other from a grid, by the gain in the normal
equations with everything else refitted. The grid is then refined around the chosen corners. The result is one column of
plays and one of kinks, whose sizes later hypotheses refit.
"""

from dataclasses import dataclass, replace

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.hypothesis.chain import LONG, Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit
from piezod.diagnose.hypothesis.gram import INDEPENDENT
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.hypothesis.terms import Point
from piezod.estimation.fit.blocks import solved

PLAYS, KINKS = 64, 48  # size of the first grids
DENSER_NEAR_ZERO = 1.5  # exponent of the grid of thresholds
AROUND = np.linspace(-0.75, 0.75, 7)  # refined grid around a chosen corner, relative to the grid distance
REFINEMENT = 0.25  # factor on the grid distance from pass to pass
PASSES, ROUNDS = 3, 2  # grids per round; rounds, each after a refit
MOST_CORNERS = 20
LEAST_GAIN = 2e-3  # least gain of a corner, relative to the squared residual
COLUMNS_AT_ONCE = 14  # as many as the smooth density has: limits the memory


@dataclass(frozen=True)
class _Grid:
    """Grid of possible corners.

    Parameters
    ----------
    places_V, distances_V
        Thresholds or kinks, rising, and the grid distance at each, shape (K,) [V].
    low_V, high_V
        Limits of the corners [V].
    """

    places_V: Array
    distances_V: Array
    low_V: float
    high_V: float

    @classmethod
    def between(cls, places_V: Array, low_V: float, high_V: float) -> "_Grid":
        """Grid of these places."""
        return cls(places_V, np.gradient(places_V), low_V, high_V)

    def refined(self, chosen: Array) -> "_Grid":
        """Finer grid around the chosen places (their numbers)."""
        steps_V = self.distances_V[chosen]
        around_V = (self.places_V[chosen][:, None] + steps_V[:, None] * AROUND).ravel()
        distances_V = np.repeat(REFINEMENT * steps_V, AROUND.size)
        inside = (around_V > self.low_V) & (around_V < self.high_V)
        unique_V, first = np.unique(around_V[inside], return_index=True)
        return _Grid(unique_V, distances_V[inside][first], self.low_V, self.high_V)


def with_corners(chain: Chain, fitted: Fitted, *, by_all: bool) -> tuple[Chain, Fitted] | None:
    """Hypothesis with further corners in its base; None if no corner gains enough.

    All recordings (`by_all`) or those of the identification determine the corners; no later effect bends the latter.
    Long recordings are not used, since a column for each place takes too much memory.
    """
    used = [k for k, s in enumerate(chain.series) if (by_all or s.role == "identification") and s.time_s.size < LONG]
    if not used:
        return None
    cornered = coarse(chain.like([chain.series[k] for k in used]))
    point = fitted.point.of(used)
    for _ in range(ROUNDS):
        normal = Normal.at(cornered, fitted.terms, fit(cornered, fitted.terms, point, most_steps=3).point)
        more = _with_more_corners(cornered, normal)
        cornered.forget()
        if more is None:
            break
        cornered, point = more
    if cornered.density is chain.density:
        return None
    result = chain.with_base(cornered.density, cornered.law)
    return result, fit(result, fitted.terms, replace(fitted.point, density=point.density, law=point.law))


def _with_more_corners(chain: Chain, normal: Normal) -> tuple[Chain, Point] | None:
    """Chain with further corners, and the start of a fit; None if no corner gains enough."""
    density, law, point = chain.density, chain.law, normal.point
    reach_V = float(density.thresholds_V[-1])
    plays = _Grid.between(reach_V * ((np.arange(PLAYS) + 0.5) / PLAYS) ** DENSER_NEAR_ZERO, 0.0, reach_V)
    kinks = _Grid.between(np.linspace(law.low_V, law.high_V, KINKS + 2)[1:-1], law.low_V, law.high_V)
    for further_passes in reversed(range(PASSES)):
        chosen, weights = _chosen(chain, normal, plays.places_V, kinks.places_V)
        if not chosen.size:
            return None
        is_play = chosen < plays.places_V.size
        chosen_plays, chosen_kinks = chosen[is_play], chosen[~is_play] - plays.places_V.size
        if further_passes:
            plays, kinks = plays.refined(chosen_plays), kinks.refined(chosen_kinks)
    thresholds_V, parts = _merged(*density.corners(point.density), plays.places_V[chosen_plays], weights[is_play])
    kinks_V, slopes = _merged(*law.corners(point.law), kinks.places_V[chosen_kinks], weights[~is_play])
    density, law = density.smooth(), law.smooth()
    coefficients, splines = point.density[: density.count], point.law[: law.count]
    if parts.size:
        density, coefficients = density.beside(thresholds_V, parts[:, None]), np.append(coefficients, 1.0)
    if slopes.size:
        law, splines = law.beside(kinks_V, slopes[:, None]), np.append(splines, 1.0)
    return chain.with_base(density, law), replace(point, density=coefficients, law=splines)


def _merged(known_V: Array, known: Array, more_V: Array, more: Array) -> tuple[Array, Array]:
    """Places and sizes of known and further corners, rising; sizes at equal places are added."""
    places_V, where = np.unique(np.append(known_V, more_V), return_inverse=True)
    sizes = np.zeros(places_V.size)
    np.add.at(sizes, where, np.append(known, more))
    return places_V, sizes


def _chosen(chain: Chain, normal: Normal, plays_V: Array, kinks_V: Array) -> tuple[Array, Array]:
    """Numbers of the corners with the largest gains, chosen one after the other (plays before kinks), and weights."""
    columns = [np.hstack(parts) for parts in zip(*_columns(chain, normal, plays_V, kinks_V), strict=True)]
    products, squares = normal.projected(columns)
    gram, sides = products[:-1, :-1], products[:-1, -1]
    least = LEAST_GAIN * sum(float(residual @ residual) for residual in normal.weighted)
    inner, along, chosen = gram.copy(), sides.copy(), list[int]()
    while len(chosen) < MOST_CORNERS:
        own = np.diag(inner)
        free = own > INDEPENDENT * squares
        gains = np.where(free, along**2 / np.where(free, own, 1.0), 0.0)
        best = int(np.argmax(gains))
        if gains[best] < least:
            break
        chosen.append(best)
        part = inner[:, best] / own[best]
        along, inner = along - part * along[best], inner - np.outer(part, inner[best])
    return np.array(chosen, dtype=np.int64), solved(gram[np.ix_(chosen, chosen)], sides[chosen])


def _columns(chain: Chain, normal: Normal, plays_V: Array, kinks_V: Array) -> list[list[Array]]:
    """Derivatives of the compared readings by the size of each corner, in batches, for every recording."""
    count, point, columns = chain.density.count, normal.point, []
    numbers = range(len(chain.series))
    for first in range(0, plays_V.size, COLUMNS_AT_ONCE):
        batch_V = plays_V[first : first + COLUMNS_AT_ONCE]
        wider = chain.with_base(chain.density.beside(batch_V, np.eye(batch_V.size)), chain.law)
        extended = replace(point, density=np.concatenate((point.density, np.zeros(batch_V.size))))
        part = slice(count, count + batch_V.size)
        columns.append([wider.tangents(number, normal.terms, extended)[:, part] for number in numbers])
        wider.forget()
    for first in range(0, kinks_V.size, COLUMNS_AT_ONCE):
        batch_V = kinks_V[first : first + COLUMNS_AT_ONCE]
        wider = chain.with_base(chain.density, chain.law.beside(batch_V, np.eye(batch_V.size)))
        extended = replace(point, law=np.concatenate((point.law, np.zeros(batch_V.size))))
        part = slice(count + chain.law.count, count + chain.law.count + batch_V.size)
        columns.append([wider.tangents(number, normal.terms, extended)[:, part] for number in numbers])
        wider.forget()
    return columns
