"""Layout of the fitted vector: the places of a hypothesis' parameters, and their scales."""

import itertools
from collections.abc import Sequence

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.hypothesis.basis import HATS, SPLINES
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.effects.parameter import Parameter

LAW_WITHIN = 0.02  # [force range] prior width of a part of the force law
LAW_BENDS = 0.02  # [force range] prior width of a second difference of the force law
FACTOR = 0.3  # prior width of a parameter on a logarithmic scale, or of a further column


class Layout:
    """Places of the parameters in the vector: density, law, offsets, starts, effects."""

    def __init__(self, chain: Chain, terms: Sequence[Term]) -> None:
        self.plays = chain.density.count
        self.offsets = self.plays + chain.law.count
        self.recordings = len(chain.series)
        self.searched: list[tuple[int, Parameter]] = [
            (number, chain.parameter(term.effect, name)) for number, term in enumerate(terms) for name in term.searched
        ]
        self.starts = self.offsets + self.recordings - 1
        self.start_edges = np.cumsum([self.starts, *chain.start_counts(terms)])
        self.effects = int(self.start_edges[-1])
        self.size = self.effects + len(self.searched)
        weights = [
            place
            for place, (number, parameter) in enumerate(self.searched, start=self.effects)
            if parameter.name in terms[number].weights
        ]
        # places of the parameters in which the chain is linear, see `Chain.tangents`
        self.carried = [*range(self.offsets), *range(self.starts, self.effects), *weights]

    def vector(self, point: Point) -> Array:
        """Vector of a point, shape (size,)."""
        searched = [scaled(parameter, point.values[term][parameter.name]) for term, parameter in self.searched]
        starts = [np.zeros(count) for count in np.diff(self.start_edges)]
        for now, known in zip(starts, point.starts, strict=False):  # an effect that comes or goes changes the decays
            now[: known.size] = known[: now.size]
        return np.concatenate((point.density, point.law, point.offsets_N[1:], *starts, searched))

    def point(self, vector: Array, like: Point) -> Point:
        """Point of a vector; parameters that are not searched have the values of the point `like`."""
        values = [dict(known) for known in like.values]
        for place, (term, parameter) in enumerate(self.searched):
            values[term][parameter.name] = unscaled(parameter, float(vector[self.effects + place]))
        return Point(
            vector[: self.plays],
            vector[self.plays : self.offsets],
            np.concatenate(([0.0], vector[self.offsets : self.starts])),
            tuple(values),
            tuple(vector[first:end] for first, end in itertools.pairwise(self.start_edges)),
        )

    def stiffness(self, samples: float) -> Array:
        """Curvature of the ridge penalties, shape (size,)."""
        stiff = np.zeros(self.size)
        stiff[self.effects :] = [samples * parameter.search.ridge for _, parameter in self.searched]
        return stiff

    def prior(self, chain: Chain, point: Point) -> Array:
        """Curvature of a weak prior about the fitted parameters, shape (size, size).

        Second differences of density and force law are bounded, so a part that no block determines continues its
        neighbours. An instant moves by one sample, because the linear step holds no further.
        """
        span_N, sample_s = chain.force_span_N, max(series.dt_s for series in chain.series)
        wide = np.empty(self.size)
        wide[: self.plays] = max(float(np.abs(point.density[:HATS]).max()), 0.1)
        wide[self.plays : self.starts] = LAW_WITHIN * span_N
        for (first, end), series in zip(itertools.pairwise(self.start_edges), chain.series, strict=True):
            wide[first:end] = LAW_WITHIN * span_N
            wide[first : first + series.start_columns.shape[1]] = LAW_WITHIN * chain.voltage_span_V
        wide[HATS : self.plays] = wide[self.plays + SPLINES : self.offsets] = FACTOR
        for place, (term, parameter) in enumerate(self.searched, start=self.effects):
            if parameter.search.logarithmic:
                wide[place] = FACTOR
            elif parameter.instant:
                wide[place] = sample_s
            else:
                least = 1e-3 * min(parameter.high - parameter.low, 1e3)
                wide[place] = max(abs(float(point.values[term][parameter.name])), least)
        prior = np.diag(wide**-2.0)
        for first, count, bend in ((0, HATS, 0.5 * wide[0]), (self.plays, SPLINES, LAW_BENDS * span_N)):
            bends = np.diff(np.eye(count), 2, axis=0) / bend
            prior[first : first + count, first : first + count] += bends.T @ bends
        return prior

    def clipped(self, vector: Array) -> Array:
        """Vector with every effect parameter inside its range."""
        result = vector.copy()
        for place, (_, parameter) in enumerate(self.searched, start=self.effects):
            low, high = scaled(parameter, parameter.low), scaled(parameter, parameter.high)
            result[place] = np.clip(result[place], low, high)
        return result


def scaled(parameter: Parameter, value: float) -> float:
    """Value on the scale that is fitted: its logarithm where the search is logarithmic."""
    if not parameter.search.logarithmic:
        return value
    return float(np.log(np.clip(value, parameter.low, parameter.high)))


def unscaled(parameter: Parameter, value: float) -> float:
    """Inverse of `scaled`, inside the range of the parameter."""
    if parameter.search.logarithmic:  # a linear step may lead so far that the exponential overflows
        value = float(np.exp(np.clip(value, np.log(parameter.low), np.log(parameter.high))))
    return float(np.clip(value, parameter.low, parameter.high))


def step_of(parameter: Parameter, value: float) -> float:
    """Step of the finite difference on the scale of the parameter; inwards at the upper bound."""
    size = 1e-3
    if not parameter.search.logarithmic:
        size *= max(abs(value), 1e-2 * min(parameter.high - parameter.low, 1e3))
    return -size if unscaled(parameter, value + size) >= parameter.high else size
