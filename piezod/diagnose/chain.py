"""The whole forward chain of a hypothesis over the recordings, and how it changes with every parameter.

    command -> amplifier -> plays (density) -> creep, gain -> force law -> mechanics -> load cell -> acquisition

Effects act where they sit. The base's columns are carried through whatever lies behind them.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.basis import HATS, SPLINES, ForceLaw, PlayDensity
from piezod.diagnose.series import Series
from piezod.effects import EFFECTS
from piezod.effects.effect import HELD_BEFORE, STRAIGHT, Context, Effect, Parameter, Seat

Array = NDArray[np.float64]

Scope = Literal["already", "since", "once"]
ORDER = {name: place for place, name in enumerate(EFFECTS)}
MOST_ROWS = 25_000
CACHED = 6  # results of the plays that are kept a recording


@dataclass(frozen=True)
class Term:
    """An effect in a hypothesis.

    Parameters
    ----------
    effect
        Of the catalogue.
    scope
        "already": in every recording, those of the identification too; "since": in those asked about; "once": in one.
    series
        Which one, for "once".
    choices
        Values of the parameters that are not searched.
    """

    effect: Effect
    scope: Scope
    series: int = -1
    choices: tuple[tuple[str, float], ...] = ()

    def acts_on(self, number: int, series: Series) -> bool:
        """Whether it is in a recording."""
        if self.scope == "once":
            return number == self.series
        return self.scope == "already" or series.role == "recording"

    @property
    def searched(self) -> tuple[str, ...]:
        """Names of the parameters that are fitted."""
        return tuple(one.name for one in self.effect.parameters if not one.choices)


@dataclass(frozen=True)
class Point:
    """Values of all parameters of a hypothesis.

    Parameters
    ----------
    density
        Of the plays, shape (HATS,) [1].
    law
        Of the force law, shape (SPLINES,) [N].
    offsets_N
        Of every recording, shape (R,); the first is 0.
    values
        Of every term.
    """

    density: Array
    law: Array
    offsets_N: Array
    values: tuple[Mapping[str, float], ...] = ()


@dataclass(frozen=True)
class Trace:
    """A simulated recording with what lies on the way.

    Parameters
    ----------
    columns
        Of the plays, shape (N, HATS) [V].
    stroke_V
        In front of the force law, shape (N,).
    reading_N
        At the end, shape (N,).
    """

    columns: Array
    stroke_V: Array
    reading_N: Array


class Chain:
    """The recordings with the operators that all hypotheses share.

    Parameters
    ----------
    series
        Identification recordings first.
    density, law
        Plays and splines.
    force_span_N
        Of the identified range.
    voltage_span_V
        Of the identified range; None: of the recordings.
    most_rows
        Samples of a recording that are compared, evenly spread; the simulation always runs over all.
    """

    def __init__(
        self,
        series: Sequence[Series],
        density: PlayDensity,
        law: ForceLaw,
        force_span_N: float,
        most_rows: int = MOST_ROWS,
        voltage_span_V: float | None = None,
    ) -> None:
        self.series = list(series)
        self.voltage_span_V = voltage_span_V or max(float(np.ptp(one.command_V)) for one in series)
        self.density, self.law, self.force_span_N = density, law, force_span_N
        self.most_rows = most_rows
        self.rows = [slice(None, None, max(1, -(-one.time_s.size // most_rows))) for one in self.series]
        self._rates = _rates(self.series)
        slow, _, _, fastest = self._rates
        self._ranges = {  # effect parameters in these units, by name
            "presliding_N": (1e-3 * force_span_N, force_span_N),
            "gap_N": (0.0, 0.9 * force_span_N),
            "reference_V_per_s": (0.03 * slow, 3.0 * fastest),
            "limit_V_per_s": (0.1 * slow, fastest),
        }
        self._lock = threading.Lock()
        self._cache: list[dict[tuple[object, ...], tuple[Array, Array, float, dict[str, Array]]]] = [
            {} for _ in self.series
        ]

    def like(self, series: Sequence[Series], most_rows: int | None = None) -> "Chain":
        """The same operators over other series."""
        return Chain(
            series, self.density, self.law, self.force_span_N, most_rows or self.most_rows, self.voltage_span_V
        )

    def parameter(self, effect: Effect, name: str) -> Parameter:
        """A parameter in the range that these recordings can show."""
        one = effect.parameter(name)
        if name not in self._ranges:
            return one
        low, high = (float(np.clip(value, one.low, one.high)) for value in self._ranges[name])
        if not low < high:
            return one
        return replace(one, low=low, high=high, starts=tuple(float(np.clip(x, low, high)) for x in one.starts))

    @property
    def rates_V_per_s(self) -> tuple[float, float, float, float]:
        """How fast the command moves in the recordings asked about: lowest tenth, median, highest tenth, fastest."""
        return self._rates

    def terms_of(self, number: int, terms: Sequence[Term], point: Point) -> list[tuple[Term, Mapping[str, float]]]:
        """Terms that act on a recording, in the order of the chain, with their values."""
        here = [
            (term, {**values, **dict(term.choices)})
            for term, values in zip(terms, point.values, strict=True)
            if term.acts_on(number, self.series[number])
        ]
        return sorted(here, key=lambda one: ORDER[one[0].effect.name])

    def context(self, number: int) -> Context:
        """What effects may look at; the command as it stands at the samples."""
        one = self.series[number]
        command_V = one.command_V
        if one.between == HELD_BEFORE:
            command_V = np.concatenate((command_V[:1], command_V[:-1]))
        return Context(
            one.dt_s,
            one.time_s,
            command_V,
            command_V,
            one.duration_s,
            self.force_span_N,
            one.temperature_C,
            one.between,
            self.voltage_span_V,
            one.path_V,
        )

    def played(self, number: int, here: Sequence[tuple[Term, Mapping[str, float]]]) -> tuple[Array, Array, Context]:
        """Applied voltage and play columns of a recording."""
        front = [(term, values) for term, values in here if term.effect.seat <= Seat.HYSTERESIS]
        key = (
            self.series[number].between,
            self.series[number].path_V,
            *((t.effect.name, tuple(v.items())) for t, v in front),
        )
        context, cache = self.context(number), self._cache[number]
        known = cache.get(key)
        if known is None:
            applied_V, factor, offset_V = context.command_V, None, None
            for term, values in front:
                if term.effect.seat == Seat.AMPLIFIER:
                    applied_V = term.effect.forward(applied_V, context, values)
                    context = replace(context, applied_V=applied_V, between=_behind(term, context), memo={})
                elif term.effect.widening is not None:
                    more, add_V = term.effect.widening(context, values)
                    factor = more if factor is None else factor * more
                    offset_V = add_V if offset_V is None else offset_V + add_V
            path_V = np.array(self.series[number].path_V)
            columns = self.density.columns(applied_V, path_V, factor, offset_V)
            known = (applied_V, columns, context.between, context.memo)
            with self._lock:
                while len(cache) >= CACHED:
                    cache.pop(next(iter(cache)))
                cache[key] = known
        applied_V, columns, between, memo = known
        return applied_V, columns, replace(context, applied_V=applied_V, between=between, memo=memo)

    def run(self, number: int, terms: Sequence[Term], point: Point) -> Trace:
        """Simulate a recording."""
        here = self.terms_of(number, terms, point)
        applied_V, columns, context = self.played(number, here)
        stroke_V = applied_V + columns @ point.density
        for term, values in here:
            if term.effect.seat == Seat.STACK:
                stroke_V = term.effect.forward(stroke_V, context, values)
                context = replace(context, between=_behind(term, context))
        signal_N = self.law.value(stroke_V, point.law)
        for term, values in here:
            if term.effect.seat >= Seat.MECHANICS:
                signal_N = term.effect.forward(signal_N, context, values)
                context = replace(context, between=_behind(term, context))
        return Trace(columns, stroke_V, signal_N + point.offsets_N[number])

    def base_tangents(self, number: int, terms: Sequence[Term], point: Point) -> Array:
        """How the readings that are compared change with density and force law, shape (rows, HATS + SPLINES)."""
        here = self.terms_of(number, terms, point)
        applied_V, columns, context = self.played(number, here)
        stroke_V, tangents = applied_V + columns @ point.density, columns
        for term, values in here:
            if term.effect.seat == Seat.STACK:
                tangents = _carried(term.effect, tangents, stroke_V, context, values)
                stroke_V = term.effect.forward(stroke_V, context, values)
                context = replace(context, between=_behind(term, context))
        behind = [one for one in here if one[0].effect.seat >= Seat.MECHANICS]
        remembers = [place for place, (term, _) in enumerate(behind) if term.effect.form == "linear"]
        signal_N, thinned = self.law.value(stroke_V, point.law), not remembers
        rows = self.rows[number]
        kept = rows if thinned else slice(None)
        splines, slopes = self.law.columns(stroke_V[kept])
        tangents = np.hstack(((slopes @ point.law)[:, None] * tangents[kept], splines))
        for place, (term, values) in enumerate(behind):
            tangents = _carried(term.effect, tangents, signal_N, context, values, rows if thinned else slice(None))
            if not thinned and place == remembers[-1]:
                tangents, thinned = tangents[rows], True
            signal_N = term.effect.forward(signal_N, context, values)
            context = replace(context, between=_behind(term, context))
        return tangents


def _rates(series: Sequence[Series]) -> tuple[float, float, float, float]:
    asked = [one for one in series if one.role == "recording"] or list(series)
    rates = np.concatenate([np.abs(np.diff(one.command_V)) / one.dt_s for one in asked])
    moving = rates[rates > 0.0]
    if not moving.size:
        return 1.0, 1.0, 1.0, 1.0
    slow, usual, fast = (float(x) for x in np.percentile(moving, (10, 50, 90)))
    return slow, usual, fast, float(moving.max())


def _behind(term: Term, context: Context) -> float:
    return STRAIGHT if term.effect.smooths else context.between


def _carried(
    effect: Effect,
    tangents: Array,
    signal: Array,
    context: Context,
    values: Mapping[str, float],
    rows: slice = slice(None),  # a slice is not mutable
) -> Array:
    """The same columns behind an effect; `rows` are those that the columns have of the signal's."""
    if effect.form == "linear":
        passed = np.empty_like(tangents, order="F")
        for k in range(tangents.shape[1]):
            passed[:, k] = effect.forward(np.ascontiguousarray(tangents[:, k]), context, values)
        return passed
    if effect.form == "memoryless":
        step = 1e-5 * (float(np.ptp(signal)) + 1e-12)
        above, below = effect.forward(signal + step, context, values), effect.forward(signal - step, context, values)
        return tangents * ((above - below)[rows] / (2.0 * step))[:, None]
    return tangents


def empty_point(chain: Chain, gain: float, offset_N: float) -> Point:
    """A straight law without hysteresis: where a fit of the base begins."""
    return Point(np.zeros(HATS), chain.law.straight(offset_N, gain), np.zeros(len(chain.series)))


__all__ = ["HATS", "SPLINES", "Chain", "Point", "Scope", "Term", "Trace", "empty_point"]
