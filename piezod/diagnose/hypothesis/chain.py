"""The whole forward chain of a hypothesis over the recordings, and how it changes with every parameter.

    command -> amplifier -> plays (density) -> creep, gain -> force law -> mechanics -> load cell -> acquisition

Effects act at their locations. The base's columns are carried through whatever lies behind them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.basis import HATS, SPLINES, ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.cache import Kept, Key
from piezod.diagnose.hypothesis.sensitivities import Passage, passages, unlike_signal
from piezod.diagnose.hypothesis.series import Series
from piezod.effects import EFFECTS
from piezod.effects.effect import Context, Effect, Location, Parameter, Past
from piezod.model.plant import behind
from piezod.recording.hold import HELD_BEFORE, Hold

Array = NDArray[np.float64]

Scope = Literal["already", "since", "once"]
ORDER = {name: place for place, name in enumerate(("loops", "gain", *EFFECTS))}
FASTEST_MODE = 0.45  # of the sampling rate; a faster one is nothing but a delay
MOST_ROWS = 25_000
CACHED, CACHED_WHEN_LONG = 4, 1  # results of every kind that are kept a recording
LONG = 250_000  # samples of a recording


Setting = tuple[dict[str, float], tuple[tuple[str, float], ...]]
"""Values of an effect's searched parameters, and its choices."""


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
    held
        Whether its parameters stay at their values: an effect of the given model that has not changed.
    """

    effect: Effect
    scope: Scope
    series: int = -1
    choices: tuple[tuple[str, float], ...] = ()
    held: bool = False

    def acts_on(self, number: int, series: Series) -> bool:
        """Whether it is in a recording."""
        if self.scope == "once":
            return number == self.series
        return self.scope == "already" or series.role == "recording"

    @property
    def searched(self) -> tuple[str, ...]:
        """Names of the parameters that are fitted."""
        return tuple(
            one.name
            for one in self.effect.parameters
            if not self.held
            and not one.search.choices
            and (one.search.only_if is None or one.search.only_if in self.choices)
        )

    @property
    def weights(self) -> tuple[str, ...]:
        """Names of those in which the chain is linear."""
        return () if self.held else self.effect.weights


@dataclass(frozen=True)
class Point:
    """Values of all parameters of a hypothesis.

    Parameters
    ----------
    density
        Of the plays' columns, shape (columns,) [1].
    law
        Of the force law's columns, shape (columns,) [N].
    offsets_N
        Of every recording, shape (R,); the first is 0.
    values
        Of every term.
    starts
        Of the columns that stand for an unknown past, one array a recording, of the stroke [V] and then of the readings
        [N]; empty: nothing.
    """

    density: Array
    law: Array
    offsets_N: Array
    values: tuple[Mapping[str, float], ...] = ()
    starts: tuple[Array, ...] = ()

    def of(self, recordings: Sequence[int]) -> "Point":
        """The same over some of the recordings."""
        starts = tuple(self.starts[k] for k in recordings) if self.starts else ()
        return replace(self, offsets_N=self.offsets_N[list(recordings)], starts=starts)

    def alike(self, other: "Point") -> bool:
        """Whether another point belongs to the same base."""
        return (self.density.size, self.law.size) == (other.density.size, other.law.size)


@dataclass(frozen=True)
class Trace:
    """A simulated recording with what lies on the way.

    Parameters
    ----------
    columns
        Of the plays, shape (N, columns) [V].
    stroke_V
        In front of the force law, shape (N,).
    reading_N
        At the end, shape (N,).
    """

    columns: Array
    stroke_V: Array
    reading_N: Array


def _named(some: Sequence[tuple[Term, Mapping[str, float]]]) -> Key:
    return tuple((term.effect.name, tuple(values.items())) for term, values in some)


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
    seen_s
        Duration that the effects of the given model refer to [s]; None: that of each recording.
    """

    def __init__(
        self,
        series: Sequence[Series],
        density: PlayDensity,
        law: ForceLaw,
        force_span_N: float,
        most_rows: int = MOST_ROWS,
        voltage_span_V: float | None = None,
        seen_s: float | None = None,
    ) -> None:
        self.series = list(series)
        self.seen_s = seen_s
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
            "frequency_Hz": (0.0, FASTEST_MODE / min(one.dt_s for one in self.series)),
        }
        kept = [CACHED if one.time_s.size < LONG else CACHED_WHEN_LONG for one in self.series]
        self._plays: list[Kept[tuple[Array, Array, Hold, dict[str, tuple[Array, Array]]]]] = [*map(Kept, kept)]
        self._sums: list[Kept[Array]] = [*map(Kept, kept)]
        self._strokes: list[Kept[tuple[Array, Hold]]] = [*map(Kept, kept)]
        self._additions: list[Kept[Array]] = [*map(Kept, kept)]

    def like(self, series: Sequence[Series], most_rows: int | None = None) -> "Chain":
        """The same operators over other series."""
        return self._with(series, self.density, self.law, most_rows or self.most_rows)

    def with_base(self, density: PlayDensity, law: ForceLaw) -> "Chain":
        """The same with other plays and another force law."""
        return self._with(self.series, density, law, self.most_rows)

    def _with(self, series: Sequence[Series], density: PlayDensity, law: ForceLaw, most_rows: int) -> "Chain":
        return Chain(series, density, law, self.force_span_N, most_rows, self.voltage_span_V, self.seen_s)

    def forget(self) -> None:
        """Let go of what is only kept for speed: a recording's plays are a hundred bytes a sample."""
        for plays, sums, strokes, added in zip(self._plays, self._sums, self._strokes, self._additions, strict=True):
            plays.forget()
            sums.forget()
            strokes.forget()
            added.forget()

    def parameter(self, effect: Effect, name: str) -> Parameter:
        """A parameter in the range that these recordings can show."""
        one = effect.parameter(name)
        if name not in self._ranges:
            return one
        low, high = (float(np.clip(value, one.low, one.high)) for value in self._ranges[name])
        if not low < high:
            return one
        starts = tuple(float(np.clip(x, low, high)) for x in one.search.starts)
        return replace(one, low=low, high=high, search=replace(one.search, starts=starts))

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
        if one.hold == HELD_BEFORE:
            command_V = np.concatenate((command_V[:1], command_V[:-1]))
        return Context(
            one.dt_s,
            one.time_s,
            command_V,
            command_V,
            one.duration_s,
            self.force_span_N,
            one.temperature_C,
            one.hold,
            self.voltage_span_V,
            one.path_V,
            self.seen_s,
        )

    def _step(self, number: int, here: Sequence[tuple[Term, Mapping[str, float]]]) -> int:
        """Samples from one that must be simulated to the next: all, where something behind the plays remembers."""
        behind_plays = [term.effect for term, _ in here if term.effect.location >= Location.STACK]
        free = {"memoryless", "scaling"}, {"memoryless", "scaling", "additive"}
        if all(one.form in free[one.location > Location.STACK] for one in behind_plays):
            return self.rows[number].step or 1
        return 1

    def played(
        self, number: int, here: Sequence[tuple[Term, Mapping[str, float]]], step: int = 1
    ) -> tuple[Array, Array, Context]:
        """Applied voltage of a recording, and its play columns at every `step`-th sample."""
        context = self.context(number)

        def moved() -> tuple[Array, Array, Hold, dict[str, tuple[Array, Array]]]:
            now, applied_V, factor, offset_V, loops = context, context.command_V, None, None, 1.0
            for term, values in here:
                if term.effect.location == Location.AMPLIFIER:
                    applied_V = term.effect.forward(applied_V, now, values)
                    now = behind(term.effect, replace(now, applied_V=applied_V, cache={}))
                elif term.effect.location == Location.HYSTERESIS and term.effect.widening is not None:
                    factor, offset_V = term.effect.widening(now, values)
                elif term.effect.location == Location.HYSTERESIS:
                    loops = values["loops"]
            path_V = np.array(self.series[number].path_V)
            columns = self.density.columns(applied_V, path_V, factor, offset_V, step)
            columns = columns if loops == 1.0 else loops * columns
            return applied_V, columns, now.hold, now.cache

        applied_V, columns, hold, cache = self._plays[number].get((*self._front(number, here), step), moved)
        return applied_V, columns, replace(context, applied_V=applied_V, hold=hold, cache=cache)

    def _front(self, number: int, here: Sequence[tuple[Term, Mapping[str, float]]]) -> Key:
        """What the plays of a recording depend on."""
        front = [(term, values) for term, values in here if term.effect.location <= Location.HYSTERESIS]
        return (self.series[number].hold, self.series[number].path_V, _named(front))

    def stroke(
        self, number: int, here: Sequence[tuple[Term, Mapping[str, float]]], point: Point, step: int = 1
    ) -> tuple[Array, Context]:
        """What stands in front of the force law of a recording at every `step`-th sample, shape (rows,) [V]."""
        applied_V, columns, context = self.played(number, here, step)
        stack = [(term, values) for term, values in here if term.effect.location == Location.STACK]
        start_V = self._started_V(number, point, step)
        of_plays = (self._front(number, here), step, point.density.tobytes(), start_V.tobytes())
        key = (*of_plays, _named(stack))

        def strained() -> tuple[Array, Hold]:
            stroke_V = self._sums[number].get(of_plays, lambda: applied_V[::step] + columns @ point.density + start_V)
            now = context
            for term, values in stack:
                if term.effect.form == "scaling":
                    stroke_V = stroke_V * self._unlike_signal(number, here, term, now, values)[::step]
                else:
                    stroke_V = term.effect.forward(stroke_V, now, values)
                now = behind(term.effect, now)
            return stroke_V, now.hold

        stroke_V, hold = self._strokes[number].get(key, strained)
        return stroke_V, replace(context, hold=hold)

    def _started_V(self, number: int, point: Point, step: int) -> Array:
        """What the unknown past of a recording adds to its stroke, shape (rows,) [V]; shape () where it is known."""
        columns = self.series[number].start_columns
        if not columns.shape[1] or not point.starts:
            return np.zeros(())
        last = -(-self.series[number].past_matters_until // step) + 1  # the rows behind it are equal
        moving = columns[::step][:last] @ point.starts[number][: columns.shape[1]]
        rows = -(-columns.shape[0] // step)
        started_V: Array = np.concatenate((moving, np.full(rows - moving.size, moving[-1])))
        return started_V

    def decays(self, number: int, terms: Sequence[Term], point: Point, rows: slice) -> Array:
        """What the unknown past of a recording can add to its readings through effects, shape (rows, columns) [1]."""
        context = self.context(number)
        context = replace(context, time_s=context.time_s[rows])
        columns = [np.empty((context.time_s.size, 0))]
        for place, past in self._pasts(number, terms):
            columns.append(past.columns(context, point.values[place]))
        return np.hstack(columns)

    def _pasts(self, number: int, terms: Sequence[Term]) -> list[tuple[int, Past]]:
        """Terms through which the unknown past of a recording reaches its readings, by their places."""
        one = self.series[number]
        if one.past_known is None:
            return []
        return [(k, t.effect.past) for k, t in enumerate(terms) if t.effect.past is not None and t.acts_on(number, one)]

    def start_counts(self, terms: Sequence[Term]) -> list[int]:
        """How many columns stand for the unknown past of each recording: of the stroke, then decays of the readings."""
        return [
            one.start_columns.shape[1] + sum(past.count for _, past in self._pasts(number, terms))
            for number, one in enumerate(self.series)
        ]

    def _decayed_N(self, number: int, terms: Sequence[Term], point: Point, rows: slice) -> Array:
        """What the unknown past of a recording adds to its readings, shape (rows,) [N]; shape () where it is known."""
        first = self.series[number].start_columns.shape[1]
        if not point.starts or point.starts[number].size <= first or not self._pasts(number, terms):
            return np.zeros(())
        columns, sizes = self.decays(number, terms, point, rows), point.starts[number][first:]
        known = min(sizes.size, columns.shape[1])  # an effect that comes or goes changes the columns
        decayed_N: Array = columns[:, :known] @ sizes[:known]
        return decayed_N

    def run(self, number: int, terms: Sequence[Term], point: Point) -> Trace:
        """Simulate a recording."""
        here = self.terms_of(number, terms, point)
        stroke_V, context = self.stroke(number, here, point)
        signal_N = self.law.value(stroke_V, point.law)
        for term, values in here:
            if term.effect.location >= Location.MECHANICS:
                signal_N = term.effect.forward(signal_N, context, values)
                context = behind(term.effect, context)
        return Trace(
            self.played(number, here)[1],
            stroke_V,
            signal_N + point.offsets_N[number] + self._decayed_N(number, terms, point, slice(None)),
        )

    def compared(self, number: int, terms: Sequence[Term], point: Point) -> Array:
        """Simulated readings of the samples that are compared, shape (rows,) [N].

        What remembers nothing is computed for these alone, what does not depend on the signal once.
        """
        here = self.terms_of(number, terms, point)
        step = self._step(number, here)
        stroke_V, context = self.stroke(number, here, point, step)
        after = [(term, values) for term, values in here if term.effect.location >= Location.MECHANICS]
        rows, thinned = self.rows[number], step > 1
        signal_N: Array = stroke_V
        for place in range(len(after) + 1):
            if not thinned and all(term.effect.form == "additive" for term, _ in after[place:]):
                signal_N, thinned = signal_N[rows], True
            if place == 0:
                signal_N = self.law.value(np.ascontiguousarray(signal_N), point.law)
            if place < len(after):
                term, values = after[place]
                if thinned and term.effect.form == "additive":
                    signal_N = signal_N + self._unlike_signal(number, here, term, context, values)[rows]
                else:
                    signal_N = term.effect.forward(signal_N, context, values)
                context = behind(term.effect, context)
        result: Array = signal_N + point.offsets_N[number] + self._decayed_N(number, terms, point, rows)
        return result

    def _unlike_signal(
        self,
        number: int,
        here: Sequence[tuple[Term, Mapping[str, float]]],
        term: Term,
        context: Context,
        values: Mapping[str, float],
    ) -> Array:
        """What an effect adds to any signal, or multiplies it by."""
        key = (self._front(number, here), context.hold, _named([(term, values)]))
        return self._additions[number].get(key, lambda: unlike_signal(term.effect, values, context))

    def tangents(self, number: int, terms: Sequence[Term], point: Point) -> Array:
        """How the readings that are compared change with density, law, starts and weights, shape (rows, all).

        Carried through the chain column by column: those of a long recording are most of what a diagnosis holds.
        """
        here = self.terms_of(number, terms, point)
        step = self._step(number, here)
        applied_V, columns, context = self.played(number, here, step)
        stack = [(term.effect, values) for term, values in here if term.effect.location == Location.STACK]
        stroke_V = applied_V[::step] + columns @ point.density + self._started_V(number, point, step)
        through_stack, stroke_V, context = passages(stack, stroke_V, context, step)
        after = [(term.effect, values) for term, values in here if term.effect.location >= Location.MECHANICS]
        through_rest, _, _ = passages(after, self.law.value(stroke_V, point.law), context, step)
        remembers = any(one.linear for one in through_rest)
        rows = self.rows[number] if step == 1 else slice(None)
        kept = slice(None) if remembers else rows
        splines, slopes = self.law.columns(stroke_V[kept])
        slope = slopes @ point.law
        del slopes

        def compared(column: Array) -> Array:
            for passage in through_rest:
                column = passage.through(column, kept)
            return column[rows] if remembers else column

        starts = self.start_counts(terms)
        base = columns.shape[1] + splines.shape[1]
        count = sum(starts) + sum(len(term.weights) for term in terms)
        tangents = np.zeros((self.series[number].counts[self.rows[number]].size, base + count), order="F")

        def carry(first: int, columns: Array, stack: Sequence[Passage]) -> None:
            for place, column in enumerate(columns.T, start=first):
                carried = np.ascontiguousarray(column)
                for passage in stack:
                    carried = passage.through(carried)
                tangents[:, place] = compared(slope * carried[kept])

        carry(0, columns, through_stack)
        for k in range(splines.shape[1]):
            tangents[:, columns.shape[1] + k] = compared(np.ascontiguousarray(splines[:, k]))
        one, first = self.series[number], base + sum(starts[:number])
        carry(first, one.start_columns[::step], through_stack)
        first += one.start_columns.shape[1]
        decays = self.decays(number, terms, point, self.rows[number])
        tangents[:, first : first + decays.shape[1]] = decays
        in_stack = [term for term, _ in here if term.effect.location == Location.STACK]
        first = base + sum(starts)
        for term in terms:
            if term.weights and term.effect.columns is not None and term in in_stack:
                own, *later = through_stack[in_stack.index(term) :]
                carry(first, term.effect.columns(own.context, own.values), later)
            first += len(term.weights)
        return tangents


def _rates(series: Sequence[Series]) -> tuple[float, float, float, float]:
    asked = [one for one in series if one.role == "recording"] or list(series)
    rates = np.concatenate([np.abs(np.diff(one.command_V)) / one.dt_s for one in asked])
    moving = rates[rates > 0.0]
    if not moving.size:
        return 1.0, 1.0, 1.0, 1.0
    slow, usual, fast = (float(x) for x in np.percentile(moving, (10, 50, 90)))
    return slow, usual, fast, float(moving.max())


def empty_point(chain: Chain, gain: float, offset_N: float) -> Point:
    """A straight law without hysteresis: where a fit of the base begins."""
    starts = tuple(np.zeros(count) for count in chain.start_counts(()))
    law = chain.law.straight(offset_N, gain)
    return Point(np.zeros(chain.density.count), law, np.zeros(len(chain.series)), starts=starts)


__all__ = ["HATS", "SPLINES", "Chain", "Point", "Scope", "Term", "Trace", "empty_point"]
