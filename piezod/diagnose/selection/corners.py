"""Corners in the base: plays of a width of their own and kinks in the force law, beside what is smooth in both.

A stack of few plays, or one behind few dead zones, has corners that no smooth density and no spline has, and what they
leave looks like friction or like a rate. Corners are chosen one after the other from many places by what each takes off
the residual when all that is fitted is fitted anew, in normal equations; then from places ever closer to the chosen
ones. What comes of it are two columns, one of plays and one of kinks: the hypotheses that follow refit the size of each
and what is smooth beside it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.chain import LONG, Chain, Point
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit, solved
from piezod.diagnose.hypothesis.sampling import coarse

Array = NDArray[np.float64]

PLAYS, KINKS = 64, 48  # places looked at first
DENSER_NEAR_ZERO = 1.5
AROUND = np.linspace(-0.75, 0.75, 7)  # of the distance to the next: looked at beside a chosen one
CLOSER = 0.25  # that distance, from one pass to the next
PASSES, ROUNDS = 3, 2
MOST_CORNERS = 20
LEAST_GAIN = 2e-3  # of the squared residual, that a corner must take off
TOGETHER = 14  # columns at a time: as many as the smooth density has
OWN_PART = 1e-6  # of a column's square, below which what is fitted follows it


@dataclass(frozen=True)
class _Places:
    """Where corners are looked for.

    Parameters
    ----------
    places_V, apart_V
        Thresholds or kinks, rising, and how far from each the next was, shape (K,) [V].
    low_V, high_V
        Between which they may lie.
    """

    places_V: Array
    apart_V: Array
    low_V: float
    high_V: float

    @classmethod
    def between(cls, places_V: Array, low_V: float, high_V: float) -> "_Places":
        """These, a place apart."""
        return cls(places_V, np.gradient(places_V), low_V, high_V)

    def nearer(self, chosen: Array) -> "_Places":
        """Places about the chosen ones (their numbers), closer together."""
        steps_V = self.apart_V[chosen]
        around_V = (self.places_V[chosen][:, None] + steps_V[:, None] * AROUND).ravel()
        apart_V = np.repeat(CLOSER * steps_V, AROUND.size)
        inside = (around_V > self.low_V) & (around_V < self.high_V)
        unique_V, first = np.unique(around_V[inside], return_index=True)
        return _Places(unique_V, apart_V[inside][first], self.low_V, self.high_V)


def sharpened(chain: Chain, found: Fitted, *, by_all: bool) -> tuple[Chain, Fitted] | None:
    """The same hypothesis with corners in its base, beside those that it has; None where none is worth it.

    Parameters
    ----------
    chain
        Recordings and base.
    found
        The hypothesis.
    by_all
        They are chosen by all recordings; else by those of the identification, where nothing bends them that has come
        since. Long ones are left out: a column for each place looked at takes their memory many times.
    """
    known = [
        k for k, one in enumerate(chain.series) if (by_all or one.role == "identification") and one.time_s.size < LONG
    ]
    if not known:
        return None
    now = coarse(chain.like([chain.series[k] for k in known]))
    point = found.point.of(known)
    for _ in range(ROUNDS):
        normal = Normal.at(now, found.terms, fit(now, found.terms, point, most_steps=3).point)
        more = _with_corners(now, normal)
        now.forget()
        if more is None:
            break
        now, point = more
    if now.density is chain.density:
        return None
    sharp = chain.with_base(now.density, now.law)
    there = replace(found.point, density=point.density, law=point.law)
    return sharp, fit(sharp, found.terms, there)


def _with_corners(chain: Chain, normal: Normal) -> tuple[Chain, Point] | None:
    """The chain with further corners, and where a fit begins there; None where no corner takes enough off."""
    density, law, point = chain.density, chain.law, normal.point
    reach_V = float(density.thresholds_V[-1])
    plays = _Places.between(reach_V * ((np.arange(PLAYS) + 0.5) / PLAYS) ** DENSER_NEAR_ZERO, 0.0, reach_V)
    kinks = _Places.between(np.linspace(law.low_V, law.high_V, KINKS + 2)[1:-1], law.low_V, law.high_V)
    for left in reversed(range(PASSES)):
        chosen, weights = _chosen(chain, normal, plays.places_V, kinks.places_V)
        if not chosen.size:
            return None
        of_play = chosen < plays.places_V.size
        some, others = chosen[of_play], chosen[~of_play] - plays.places_V.size
        if left:
            plays, kinks = plays.nearer(some), kinks.nearer(others)
    known_V, parts = density.corners(point.density)
    thresholds_V, parts = _merged(known_V, parts, plays.places_V[some], weights[of_play])
    bends_V, leaps = law.corners(point.law)
    bends_V, leaps = _merged(bends_V, leaps, kinks.places_V[others], weights[~of_play])
    density, law = density.smooth(), law.smooth()
    coefficients, splines = point.density[: density.count], point.law[: law.count]
    if parts.size:
        density, coefficients = density.beside(thresholds_V, parts[:, None]), np.append(coefficients, 1.0)
    if leaps.size:
        law, splines = law.beside(bends_V, leaps[:, None]), np.append(splines, 1.0)
    return chain.with_base(density, law), replace(point, density=coefficients, law=splines)


def _merged(known_V: Array, known: Array, more_V: Array, more: Array) -> tuple[Array, Array]:
    """Places and sizes of corners, rising, each place once."""
    places_V, where = np.unique(np.append(known_V, more_V), return_inverse=True)
    sizes = np.zeros(places_V.size)
    np.add.at(sizes, where, np.append(known, more))
    return places_V, sizes


def _chosen(chain: Chain, normal: Normal, plays_V: Array, kinks_V: Array) -> tuple[Array, Array]:
    """Numbers of the corners that take most off, plays before kinks, one after the other, and their weights."""
    columns = [np.hstack(parts) for parts in zip(*_columns(chain, normal, plays_V, kinks_V), strict=True)]
    whole, sides, squares = normal.projected(columns)
    enough = LEAST_GAIN * sum(float(one @ one) for one in normal.weighted)
    inner, along, chosen = whole.copy(), sides.copy(), list[int]()
    while len(chosen) < MOST_CORNERS:
        own = np.diag(inner)
        free = own > OWN_PART * squares
        gains = np.where(free, along**2 / np.where(free, own, 1.0), 0.0)
        best = int(np.argmax(gains))
        if gains[best] < enough:
            break
        chosen.append(best)
        part = inner[:, best] / own[best]
        along, inner = along - part * along[best], inner - np.outer(part, inner[best])
    return np.array(chosen, dtype=np.int64), solved(whole[np.ix_(chosen, chosen)], sides[chosen])


def _columns(chain: Chain, normal: Normal, plays_V: Array, kinks_V: Array) -> list[list[Array]]:
    """How the readings that are compared change with each corner, some together, for every recording."""
    count, point, found = chain.density.count, normal.point, []
    numbers = range(len(chain.series))
    for first in range(0, plays_V.size, TOGETHER):
        some_V = plays_V[first : first + TOGETHER]
        wider = chain.with_base(chain.density.beside(some_V, np.eye(some_V.size)), chain.law)
        there = replace(point, density=np.concatenate((point.density, np.zeros(some_V.size))))
        part = slice(count, count + some_V.size)
        found.append([wider.tangents(number, normal.terms, there)[:, part] for number in numbers])
        wider.forget()
    for first in range(0, kinks_V.size, TOGETHER):
        some_V = kinks_V[first : first + TOGETHER]
        wider = chain.with_base(chain.density, chain.law.beside(some_V, np.eye(some_V.size)))
        there = replace(point, law=np.concatenate((point.law, np.zeros(some_V.size))))
        part = slice(count + chain.law.count, count + chain.law.count + some_V.size)
        found.append([wider.tangents(number, normal.terms, there)[:, part] for number in numbers])
        wider.forget()
    return found
