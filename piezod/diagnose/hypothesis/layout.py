"""Where the parameters of a hypothesis stand in the vector that is fitted, and on which scale."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.chain import HATS, SPLINES, Chain, Point, Term
from piezod.effects.effect import Parameter

Array = NDArray[np.float64]

LAW_WITHIN = 0.02  # of the force's range; a part of the force law that one block alone tells
LAW_BENDS = 0.02  # of the force's range, from one spline to the next and the next
FACTOR = 0.3  # of a parameter on a logarithmic scale, or of a column's part


class Layout:
    """Where the parameters of a hypothesis stand in the vector: density, law, offsets, starts, effects."""

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
            for place, (number, one) in enumerate(self.searched, start=self.effects)
            if one.name in terms[number].weights
        ]
        # those of which the chain knows the tangents
        self.carried = [*range(self.offsets), *range(self.starts, self.effects), *weights]

    def vector(self, point: Point) -> Array:
        """All parameters of a point."""
        searched = [scaled(one, point.values[number][one.name]) for number, one in self.searched]
        starts = [np.zeros(count) for count in np.diff(self.start_edges)]
        for now, known in zip(starts, point.starts, strict=False):  # without decays where nothing remembers long
            now[: known.size] = known[: now.size]
        return np.concatenate((point.density, point.law, point.offsets_N[1:], *starts, searched))

    def point(self, vector: Array, like: Point) -> Point:
        """The point of a vector, with what is not searched as in another."""
        values = [dict(one) for one in like.values]
        for place, (number, one) in enumerate(self.searched):
            values[number][one.name] = unscaled(one, float(vector[self.effects + place]))
        return Point(
            vector[: self.plays],
            vector[self.plays : self.offsets],
            np.concatenate(([0.0], vector[self.offsets : self.starts])),
            tuple(values),
            tuple(vector[first:end] for first, end in itertools.pairwise(self.start_edges)),
        )

    def stiffness(self, samples: float) -> Array:
        """Curvature of what draws stiff parameters to zero, shape (size,)."""
        stiff = np.zeros(self.size)
        stiff[self.effects :] = [samples * one.search.ridge for _, one in self.searched]
        return stiff

    def prior(self, chain: Chain, point: Point) -> Array:
        """Curvature of a weak prior: by how much a parameter may differ where nothing tells, shape (size, size).

        Density and law may bend only so much; what one block alone tells of them is continued from beside it. An edge
        stays within a sample of where it was found: what moving it does is straight no further.
        """
        span_N, sample_s = chain.force_span_N, max(one.dt_s for one in chain.series)
        wide = np.empty(self.size)
        wide[: self.plays] = max(float(np.abs(point.density[:HATS]).max()), 0.1)
        wide[self.plays : self.starts] = LAW_WITHIN * span_N
        for (first, end), series in zip(itertools.pairwise(self.start_edges), chain.series, strict=True):
            wide[first:end] = LAW_WITHIN * span_N
            wide[first : first + series.start_columns.shape[1]] = LAW_WITHIN * chain.voltage_span_V
        wide[HATS : self.plays] = wide[self.plays + SPLINES : self.offsets] = FACTOR
        for place, (number, one) in enumerate(self.searched, start=self.effects):
            if one.search.logarithmic:
                wide[place] = FACTOR
            elif one.instant:
                wide[place] = sample_s
            else:
                wide[place] = max(abs(float(point.values[number][one.name])), 1e-3 * min(one.high - one.low, 1e3))
        prior = np.diag(wide**-2.0)
        for first, count, bend in ((0, HATS, 0.5 * wide[0]), (self.plays, SPLINES, LAW_BENDS * span_N)):
            bends = np.diff(np.eye(count), 2, axis=0) / bend
            prior[first : first + count, first : first + count] += bends.T @ bends
        return prior

    def clipped(self, vector: Array) -> Array:
        """The same within every parameter's range."""
        result = vector.copy()
        for place, (_, one) in enumerate(self.searched, start=self.effects):
            result[place] = np.clip(result[place], scaled(one, one.low), scaled(one, one.high))
        return result


def scaled(one: Parameter, value: float) -> float:
    """A parameter's value on the scale that it is fitted on."""
    return float(np.log(np.clip(value, one.low, one.high))) if one.search.logarithmic else value


def unscaled(one: Parameter, value: float) -> float:
    """The value of what stands on that scale, within the parameter's range."""
    return float(np.clip(np.exp(value) if one.search.logarithmic else value, one.low, one.high))


def step_of(one: Parameter, value: float) -> float:
    """How far a parameter is moved to see what it does, on its scale; inwards at a bound."""
    size = 1e-3 if one.search.logarithmic else 1e-3 * max(abs(value), 1e-2 * min(one.high - one.low, 1e3))
    return -size if unscaled(one, value + size) >= one.high else size
