"""Screening: estimated loss with every effect of the catalogue at its starts, alone and in pairs.

The estimates are algebra on one set of products (`hypothesis/gram.py`). They choose the hypotheses that are fitted.
Acceptance needs the fit.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.candidates.direct import peaks_Hz, skew_ppm
from piezod.diagnose.candidates.starts import (
    Candidate,
    Start,
    catalogue_starts,
    parts_of,
    recorded_channels,
    within_ranges,
)
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.gram import Eliminated
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.terms import Point, Scope, Term
from piezod.diagnose.rules import RULES
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect

PAIR_GAIN = 1.1  # least gain of a pair over the best single gain
PAIRS = 40  # best pairs by the gain in all data, whose left-out losses are computed
DELAYS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # delays [samples] with which a narrow effect is tried
MOVES = (1.0, 0.5, 0.0)  # parts of the joint move of the fitted parameters that a start is tried with
SIZES = (1.0, 0.5)  # parts of the size that a start is tried with
SCOPES: tuple[Scope, ...] = ("since", "already")


@dataclass(frozen=True)
class Estimate:
    """One or two further effects, and the estimated loss with them.

    Parameters
    ----------
    candidates
        The effects, with the sizes of the joint linear solution.
    loss
        Left-out loss of that solution [noise variance].
    columns, multiples
        Columns of the changes, and their multiples in the solution.
    """

    candidates: tuple[Candidate, ...]
    loss: float
    columns: tuple[int, ...]
    multiples: Array

    @property
    def name(self) -> str:
        """Name of the last effect."""
        return self.candidates[-1].term.effect.name

    @property
    def penalised(self) -> float:
        """Loss with the price of the parameters, for comparisons."""
        searched = sum(min(len(candidate.term.searched), RULES.most_priced) for candidate in self.candidates)
        return self.loss * (1.0 + RULES.parameter_price * searched)


def _skews(chain: Chain, terms: Sequence[Term], point: Point) -> dict[str, tuple[float, ...]]:
    """Starts of a skew of the clocks, with those that the readings show."""
    visible = [
        skew_ppm(series, chain.run(number, terms, point).reading_N)
        for number, series in enumerate(chain.series)
        if series.role == "recording"
    ]
    shown_ppm = tuple(ppm for ppm in visible if ppm is not None)
    return {key: (*starts, *shown_ppm) for key, starts in _starts_seen_in("clock").items()}


def _starts_seen_in(test: str) -> dict[str, tuple[float, ...]]:
    """Starts of the parameters that a test of the residual shows, by effect and parameter."""
    return {
        f"{name} {parameter.name}": parameter.search.starts
        for name, effect in EFFECTS.items()
        for parameter in effect.parameters
        if parameter.search.seen_in == test
    }


@dataclass(frozen=True)
class _Start:
    """Effect at a start, and the columns of its changes: one for each part of a sum."""

    effect: Effect
    values: dict[str, float]
    choices: tuple[tuple[str, float], ...]
    columns: range

    def candidate(self, scope: Scope, multiples: Array) -> Candidate:
        """Candidate with the sizes of a solution; a parameter on a logarithmic scale stays at its start."""
        sizes = list(parts_of(self.effect, self.values)) if len(self.columns) > 1 else [self.effect.size.name]
        scaled = {
            name: float(multiple) * self.values[name]
            for name, multiple in zip(sizes, multiples, strict=True)
            if not self.effect.parameter(name).search.logarithmic
        }
        term = Term(self.effect, scope, choices=self.choices)
        return Candidate(term, {**self.values, **within_ranges(self.effect, scaled)})

    def possible(self, multiples: Array) -> bool:
        """Whether the effect can have these multiples of its size."""
        return multiples.size > 1 or multiples[0] > 0.0 or (multiples[0] < 0.0 and self.effect.size.low < 0.0)


class Screening:
    """Estimated losses of a fitted hypothesis with further effects.

    Parameters
    ----------
    assumptions
        The same recordings under other assumptions, such as another course of the command.
    """

    def __init__(self, chain: Chain, terms: Sequence[Term], point: Point, assumptions: Sequence[Chain] = ()) -> None:
        self.chain, self.terms, self.point = chain, tuple(terms), point
        self.normal = Normal.at(chain, terms, point, robust=False)
        self._changes: list[list[Array]] = []  # of the readings, an array of shape (rows,) per recording and column
        self._starts: list[_Start] = []
        for start, changes in zip(found := self._catalogue(), each(self._changes_by, found), strict=True):
            self._starts.append(_Start(*start, range(len(self._changes), len(self._changes) + len(changes))))
            self._changes += changes
        self._behind_delays = self._narrow_behind_delays()
        self._assumed = len(self._changes)
        self._changes += [self._change(terms, point, assumed) for assumed in assumptions]
        numbers = range(len(chain.series))
        acts = [
            np.array([scope == "already" or series.role == "recording" for series in chain.series], float)
            for scope in SCOPES
        ]
        columns = [np.array([change[number] for change in self._changes]).T for number in numbers]
        self._products = Eliminated.at(self.normal, columns, acts)
        del columns

    @property
    def loss(self) -> float:
        """Left-out loss of the hypothesis [noise variance]."""
        return self._products.loss

    def _catalogue(self) -> list[Start]:
        """Starts of all effects that the hypothesis lacks, also where the residual shows modes, skews or delays."""
        modelled = self.normal.readings()
        modes_Hz = [
            peak_Hz
            for series, readings_N in zip(self.chain.series, modelled, strict=True)
            if series.role == "recording"
            for peak_Hz in peaks_Hz(series, series.reading_N - readings_N)
        ]
        known = {key: (*modes_Hz, *starts) for key, starts in _starts_seen_in("spectrum").items()}
        known |= _skews(self.chain, self.terms, self.point)
        for effect in EFFECTS.values():
            if effect.is_delay:
                shortest_s = min(series.dt_s for series in self.chain.series)
                delays = tuple(delay * shortest_s for delay in DELAYS)
                known[f"{effect.name} {effect.size.name}"] = (*delays, *effect.size.search.starts)
        starts = catalogue_starts(self.chain, recorded_channels(self.chain.series), known)
        return [start for start in starts if all(term.effect is not start[0] for term in self.terms)]

    def _change(self, terms: Sequence[Term], point: Point, chain: Chain | None = None) -> list[Array]:
        """Change of the compared readings of every recording, by further terms or on another chain."""
        on = chain or self.chain
        return [on.compared(k, terms, point) - self.normal.compared[k] for k in range(len(on.series))]

    def _changes_by(self, start: Start) -> list[list[Array]]:
        effect, values, choices = start
        terms = (*self.terms, Term(effect, "already", choices=choices))
        return [
            self._change(terms, replace(self.point, values=(*self.point.values, part)))
            for part in parts_of(effect, values).values()
        ]

    def _narrow_behind_delays(self) -> list[tuple[_Start, _Start]]:
        """Each delay with each narrow effect behind it: its jumps are a sample wide, and late by the delay."""
        pairs = []
        for delay in [start for start in self._starts if start.effect.is_delay]:
            late = Term(delay.effect, "already"), delay.values
            for narrow in [start for start in self._starts if start.effect.narrow and not start.effect.is_delay]:
                both = (*self.terms, late[0], Term(narrow.effect, "already", choices=narrow.choices))
                point = replace(self.point, values=(*self.point.values, late[1], narrow.values))
                (alone,) = (self._changes[column] for column in delay.columns)
                change = [one - other for one, other in zip(self._change(both, point), alone, strict=True)]
                pairs.append((delay, replace(narrow, columns=range(len(self._changes), len(self._changes) + 1))))
                self._changes.append(change)
        return pairs

    def _of(self, start: _Start, scope: Scope) -> list[int]:
        """Columns of an effect in a scope."""
        return [SCOPES.index(scope) * len(self._changes) + column for column in start.columns]

    def _estimate(self, starts: Sequence[tuple[_Start, Scope]]) -> Estimate | None:
        """Estimate for effects together; None where one of them cannot have its size."""
        groups = [self._of(*start) for start in starts]
        columns = [column for group in groups for column in group]
        multiples = self._products.multiples(columns)
        parts = np.split(multiples, np.cumsum([len(group) for group in groups])[:-1])
        if not all(start.possible(part) for (start, _), part in zip(starts, parts, strict=True)):
            return None
        candidates = tuple(start.candidate(scope, part) for (start, scope), part in zip(starts, parts, strict=True))
        loss = self._products.loss_with(columns, multiples)
        return Estimate(candidates, loss, tuple(columns), multiples)

    @functools.cached_property
    def singles(self) -> list[Estimate]:
        """Each effect at each start, in both scopes; the smallest loss first."""
        found = (self._estimate([(start, scope)]) for start in self._starts for scope in SCOPES)
        return sorted((one for one in found if one is not None), key=_penalised)

    @functools.cached_property
    def pairs(self) -> list[Estimate]:
        """Best pair of starts of each two effects; the smallest loss first."""
        options = [(start, scope) for start in self._starts for scope in SCOPES]
        groups = [self._of(*option) for option in options]
        gains = self._products.pair_gains(groups)
        limit = PAIR_GAIN * float(np.max(np.diag(gains), initial=0.0))
        best: dict[tuple[str, str], Estimate] = {}
        fitted = 0
        for place in np.argsort(-gains, axis=None):
            i, j = divmod(int(place), len(options))
            names = options[i][0].effect.name, options[j][0].effect.name
            if gains[i, j] <= limit or fitted == PAIRS:
                break
            if i >= j or names[0] == names[1] or names in best:
                continue
            estimate = self._estimate([options[i], options[j]])
            if estimate is not None:
                best[names], fitted = estimate, fitted + 1
        late = [
            estimate
            for delay, narrow in self._behind_delays
            for scope in SCOPES
            for other in SCOPES
            if (estimate := self._estimate([(delay, scope), (narrow, other)])) is not None
        ]
        late = sorted(late, key=_penalised)[:2]
        return sorted([*best.values(), *late], key=_penalised)

    def loss_under(self, assumption: int, estimate: Estimate) -> float:
        """Left-out loss of a estimate under another assumption, by its number."""
        columns = [*estimate.columns, SCOPES.index("already") * len(self._changes) + self._assumed + assumption]
        return self._products.loss_with(columns, self._products.multiples(columns))

    def start(self, estimate: Estimate) -> tuple[tuple[Term, ...], Point]:
        """Terms and start of a fit: fitted parameters and sizes moved as far towards the solution as helps."""
        terms = (*self.terms, *(candidate.term for candidate in estimate.candidates))
        layout, moves = self.normal.layout, self._products.moves
        vector = layout.vector(self.point)
        best, least = self.point, np.inf
        for size in SIZES:
            values = tuple(_smaller(candidate, size) for candidate in estimate.candidates)
            multiples = np.where(self._sized(estimate), size * estimate.multiples, 1.0)
            step = moves[:, -1] - moves[:, list(estimate.columns)] @ multiples
            for part in MOVES:
                moved = layout.point(layout.clipped(vector + part * step), self.point)
                point = replace(moved, values=(*moved.values, *values))
                squares = squares_at(self.chain, terms, point)
                if squares < least:
                    best, least = point, squares
        return terms, best

    def _sized(self, estimate: Estimate) -> NDArray[np.bool_]:
        """Which columns of a estimate belong to a size on a linear scale."""
        flags: list[bool] = []
        for candidate in estimate.candidates:
            effect = candidate.term.effect
            parts = parts_of(effect, candidate.values)
            flags += [len(parts) > 1 or not effect.size.search.logarithmic] * len(parts)
        return np.array(flags)


def squares_at(chain: Chain, terms: Sequence[Term], point: Point) -> float:
    """Squared residual of the compared readings [noise variance]."""
    residuals = (
        series.residual(chain.rows[k], chain.compared(k, terms, point))[0] for k, series in enumerate(chain.series)
    )
    squares = sum(float(residual @ residual) for residual in residuals)
    return squares if np.isfinite(squares) else np.inf


def _smaller(candidate: Candidate, part: float) -> dict[str, float]:
    """Values of a candidate with a part of its size, where the size is on a linear scale."""
    effect = candidate.term.effect
    sizes = parts_of(effect, candidate.values)
    names = list(sizes) if len(sizes) > 1 else [effect.size.name]
    scaled = {name: part * candidate.values[name] for name in names if not effect.parameter(name).search.logarithmic}
    return {**candidate.values, **within_ranges(effect, scaled)}


def _penalised(estimate: Estimate) -> float:
    return estimate.penalised
