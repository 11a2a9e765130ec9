"""The forward chain of a hypothesis over the recordings, and how the readings change with every parameter.

    command -> amplifier -> plays (density) -> stack -> force law -> mechanics, load cell, acquisition -> reading

The effects act as in `piezod.model.chain.forward`. Plays and force law are columns of a base, and the tangents of the
base pass through the effects behind them.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.effects import EFFECTS
from piezod.effects.effect import Context, Effect, Location, Past
from piezod.effects.parameter import Driven, Parameter
from piezod.estimation.recordings.series import Series
from piezod.model.chain.cache import Cache, Key
from piezod.model.chain.forward import Acting, amplified, as_sampled, behind, through, widening
from piezod.model.chain.sensitivities import Linearised, linearised, unlike_signal
from piezod.recording.hold import Hold

MOST_ROWS = 25_000
CACHED, CACHED_WHEN_LONG = 4, 1  # results of each kind that are cached for a recording
LONG = 250_000  # samples of a recording


@dataclass(frozen=True)
class Trace:
    """A simulated recording."""

    columns: Array  # play columns, shape (N, columns) [V]
    stroke_V: Array  # stroke in front of the force law, shape (N,) [V]
    reading_N: Array  # readings, shape (N,) [N]


ActingTerms = Sequence[tuple[Term, Mapping[str, float]]]
"""Terms that act on a recording, with their values, in the order of the chain."""


def _key(terms: ActingTerms) -> Key:
    return tuple((term.effect.name, tuple(values.items())) for term, values in terms)


def _effects(terms: ActingTerms, first: Location, last: Location) -> Acting:
    return [(term.effect, values) for term, values in terms if first <= term.effect.location <= last]


def _place(effect: Effect) -> tuple[int, int]:
    """Place in the chain; a change of the stack comes first at its location."""
    names = tuple(EFFECTS)
    return effect.location, names.index(effect.name) if effect.name in names else -1


class Chain:
    """Recordings, and the base that all hypotheses about them share.

    Parameters
    ----------
    series
        Recordings; the identification recordings come first.
    force_span_N
        Force range of the identification [N].
    most_rows
        Largest number of samples of a recording that are compared, evenly spread. All samples are simulated.
    voltage_span_V
        Voltage range of the identification [V]; None: that of the recordings.
    until_s
        Monotonic time at which fits end where they are [s].
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
        until_s: float = np.inf,
    ) -> None:
        self.series = list(series)
        self.seen_s, self.until_s = seen_s, until_s
        self.voltage_span_V = voltage_span_V or max(float(np.ptp(recording.command_V)) for recording in series)
        self.density, self.law, self.force_span_N = density, law, force_span_N
        self.most_rows = most_rows
        self.rows = [slice(None, None, max(1, -(-recording.time_s.size // most_rows))) for recording in self.series]
        worked = [recording for recording in self.series if recording.role == "recording"] or self.series
        top_V = max(float(recording.command_V.max()) for recording in worked)
        dt_s = min(recording.dt_s for recording in self.series)
        self.driven = Driven(force_span_N, top_V, *_rates(worked), dt_s)
        sizes = [CACHED if recording.time_s.size < LONG else CACHED_WHEN_LONG for recording in self.series]
        self._amplified: list[Cache[Context]] = [*map(Cache, sizes)]
        self._plays: list[Cache[tuple[Context, Array]]] = [*map(Cache, sizes)]
        self._sums: list[Cache[Array]] = [*map(Cache, sizes)]
        self._strokes: list[Cache[tuple[Array, Hold]]] = [*map(Cache, sizes)]
        self._additions: list[Cache[Array]] = [*map(Cache, sizes)]

    def like(self, series: Sequence[Series], most_rows: int | None = None) -> "Chain":
        """Chain of other recordings with this base."""
        return self._with(series, self.density, self.law, most_rows or self.most_rows)

    def with_base(self, density: PlayDensity, law: ForceLaw) -> "Chain":
        """Chain of these recordings with another base."""
        return self._with(self.series, density, law, self.most_rows)

    def _with(self, series: Sequence[Series], density: PlayDensity, law: ForceLaw, most_rows: int) -> "Chain":
        spans = self.force_span_N, most_rows, self.voltage_span_V, self.seen_s
        return Chain(series, density, law, *spans, self.until_s)

    def within(self, until_s: float) -> "Chain":
        """Chain whose fits end at a monotonic time [s]."""
        limited = self.like(self.series)
        limited.until_s = until_s
        return limited

    @property
    def is_late(self) -> bool:
        """Whether the time of its fits is over."""
        return time.monotonic() > self.until_s

    def forget(self) -> None:
        """Empty the caches: the plays of a recording take a hundred bytes a sample."""
        for caches in zip(self._amplified, self._plays, self._sums, self._strokes, self._additions, strict=True):
            for cache in caches:
                cache.clear()

    def parameter(self, effect: Effect, name: str) -> Parameter:
        """Parameter in the range that these recordings can show."""
        return effect.parameter(name).within(self.driven)

    def terms_of(self, number: int, terms: Sequence[Term], point: Point) -> list[tuple[Term, Mapping[str, float]]]:
        """Terms that act on a recording, with their values, in the order of the chain."""
        acting = [
            (term, {**values, **dict(term.choices)})
            for term, values in zip(terms, point.values, strict=True)
            if term.acts_on(number, self.series[number])
        ]
        return sorted(acting, key=lambda pair: _place(pair[0].effect))

    def context(self, number: int) -> Context:
        """Context of a recording; the command as it stands when the readings are taken."""
        series = self.series[number]
        command_V = as_sampled(series.command_V, series.hold)
        return Context(
            series.dt_s,
            series.time_s,
            command_V,
            command_V,
            series.duration_s,
            self.force_span_N,
            series.temperature_C,
            series.hold,
            self.voltage_span_V,
            series.path_V,
            self.seen_s,
        )

    def _step(self, number: int, acting: ActingTerms) -> int:
        """Spacing of the samples that must be simulated: 1 where an effect behind the plays has a memory."""
        behind_plays = [term.effect for term, _ in acting if term.effect.location >= Location.STACK]
        free = {"memoryless", "scaling"}, {"memoryless", "scaling", "additive"}
        if all(effect.form in free[effect.location > Location.STACK] for effect in behind_plays):
            return self.rows[number].step or 1
        return 1

    def played(self, number: int, acting: ActingTerms, step: int = 1) -> tuple[Array, Array, Context]:
        """Applied voltage of a recording, its play columns at every `step`-th sample, and the context behind them."""

        def simulate() -> tuple[Context, Array]:
            front = _effects(acting, Location.AMPLIFIER, Location.HYSTERESIS)
            context = self._behind_amplifier(number, acting)
            factor, offset_V = widening(front, context)
            path_V = np.array(self.series[number].path_V)
            columns = self.density.columns(context.applied_V, path_V, factor, offset_V, step)
            for _, values in front:
                columns = columns * values["loops"] if "loops" in values and values["loops"] != 1.0 else columns
            return context, columns

        context, columns = self._plays[number].get((*self._front(number, acting), step), simulate)
        return context.applied_V, columns, context

    def _behind_amplifier(self, number: int, acting: ActingTerms) -> Context:
        """Context behind the amplifier; the cache of an effect in it serves for all plays."""
        amplifier = _effects(acting, Location.AMPLIFIER, Location.AMPLIFIER)
        key = self._front(number, acting, Location.AMPLIFIER)
        return self._amplified[number].get(key, lambda: amplified(amplifier, self.context(number)))

    def _front(self, number: int, acting: ActingTerms, last: Location = Location.HYSTERESIS) -> Key:
        """Key of everything that the plays of a recording depend on, or the voltage behind the amplifier (`last`)."""
        front = [(term, values) for term, values in acting if term.effect.location <= last]
        return (self.series[number].hold, self.series[number].path_V, _key(front))

    def stroke(self, number: int, acting: ActingTerms, point: Point, step: int = 1) -> tuple[Array, Context]:
        """Stroke in front of the force law at every `step`-th sample, shape (rows,) [V], and the context behind it."""
        applied_V, columns, context = self.played(number, acting, step)
        stack = [(term, values) for term, values in acting if term.effect.location == Location.STACK]
        start_V = self._started_V(number, point, step)
        of_plays = (self._front(number, acting), step, point.density.tobytes(), start_V.tobytes())

        def simulate() -> tuple[Array, Hold]:
            stroke_V = self._sums[number].get(of_plays, lambda: applied_V[::step] + columns @ point.density + start_V)
            now = context
            for term, values in stack:
                if term.effect.form == "scaling":
                    stroke_V = stroke_V * self._unlike_signal(number, acting, term, now, values)[::step]
                else:
                    stroke_V = term.effect.forward(stroke_V, now, values)
                now = behind(term.effect, now)
            return stroke_V, now.hold

        stroke_V, hold = self._strokes[number].get((*of_plays, _key(stack)), simulate)
        return stroke_V, replace(context, hold=hold)

    def _started_V(self, number: int, point: Point, step: int) -> Array:
        """Stroke from the unknown past of a recording, shape (rows,) [V]; shape () where the past is known."""
        columns = self.series[number].start_columns
        if not columns.shape[1] or not point.starts:
            return np.zeros(())
        last = -(-self.series[number].past_matters_until // step) + 1  # the rows behind it are equal
        moving = columns[::step][:last] @ point.starts[number][: columns.shape[1]]
        rows = -(-columns.shape[0] // step)
        started_V: Array = np.concatenate((moving, np.full(rows - moving.size, moving[-1])))
        return started_V

    def decays(self, number: int, terms: Sequence[Term], point: Point, rows: slice) -> Array:
        """Decays of the unknown past of a recording through the effects, shape (rows, columns) [1]."""
        context = self.context(number)
        context = replace(context, time_s=context.time_s[rows])
        columns = [np.empty((context.time_s.size, 0))]
        for place, past in self._pasts(number, terms):
            columns.append(past.columns(context, point.values[place]))
        return np.hstack(columns)

    def _pasts(self, number: int, terms: Sequence[Term]) -> list[tuple[int, Past]]:
        """Terms through which the unknown past of a recording reaches its readings, by their places."""
        series = self.series[number]
        if series.past_known is None:
            return []
        return [
            (place, term.effect.past)
            for place, term in enumerate(terms)
            if term.effect.past is not None and term.acts_on(number, series)
        ]

    def start_counts(self, terms: Sequence[Term]) -> list[int]:
        """Number of columns of the unknown past of each recording: of the stroke, and decays of the readings."""
        return [
            series.start_columns.shape[1] + sum(past.count for _, past in self._pasts(number, terms))
            for number, series in enumerate(self.series)
        ]

    def _decayed_N(self, number: int, terms: Sequence[Term], point: Point, rows: slice) -> Array:
        """Readings from the unknown past of a recording, shape (rows,) [N]; shape () where the past is known."""
        first = self.series[number].start_columns.shape[1]
        if not point.starts or point.starts[number].size <= first or not self._pasts(number, terms):
            return np.zeros(())
        columns, sizes = self.decays(number, terms, point, rows), point.starts[number][first:]
        known = min(sizes.size, columns.shape[1])  # an effect that comes or goes changes the columns
        decayed_N: Array = columns[:, :known] @ sizes[:known]
        return decayed_N

    def run(self, number: int, terms: Sequence[Term], point: Point) -> Trace:
        """Simulate all samples of a recording."""
        acting = self.terms_of(number, terms, point)
        stroke_V, context = self.stroke(number, acting, point)
        behind_law = _effects(acting, Location.MECHANICS, Location.ACQUISITION)
        signal_N, _ = through(behind_law, self.law.value(stroke_V, point.law), context)
        reading_N = signal_N + point.offsets_N[number] + self._decayed_N(number, terms, point, slice(None))
        return Trace(self.played(number, acting)[1], stroke_V, reading_N)

    def compared(self, number: int, terms: Sequence[Term], point: Point) -> Array:
        """Simulated readings of the samples that are compared, shape (rows,) [N].

        Effects without memory are computed for these samples only. A term that does not depend on the signal is
        computed once.
        """
        acting = self.terms_of(number, terms, point)
        step = self._step(number, acting)
        stroke_V, context = self.stroke(number, acting, point, step)
        after = [(term, values) for term, values in acting if term.effect.location >= Location.MECHANICS]
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
                    signal_N = signal_N + self._unlike_signal(number, acting, term, context, values)[rows]
                else:
                    signal_N = term.effect.forward(signal_N, context, values)
                context = behind(term.effect, context)
        result: Array = signal_N + point.offsets_N[number] + self._decayed_N(number, terms, point, rows)
        return result

    def _unlike_signal(
        self, number: int, acting: ActingTerms, term: Term, context: Context, values: Mapping[str, float]
    ) -> Array:
        """Term that an effect adds to any signal, or factor that it multiplies it by, shape (N,)."""
        key = (self._front(number, acting), context.hold, _key([(term, values)]))
        return self._additions[number].get(key, lambda: unlike_signal(term.effect, values, context))

    def tangents(self, number: int, terms: Sequence[Term], point: Point) -> Array:
        """Derivatives of the compared readings by density, law, starts and weights, shape (rows, all).

        The columns pass through the chain one by one, because those of a long recording are most of a diagnosis'
        memory.
        """
        acting = self.terms_of(number, terms, point)
        step = self._step(number, acting)
        applied_V, columns, context = self.played(number, acting, step)
        in_stack = [term for term, _ in acting if term.effect.location == Location.STACK]
        stroke_V = applied_V[::step] + columns @ point.density + self._started_V(number, point, step)
        stack = _effects(acting, Location.STACK, Location.STACK)
        through_stack, stroke_V, context = linearised(stack, stroke_V, context, step)
        after = _effects(acting, Location.MECHANICS, Location.ACQUISITION)
        through_rest, _, _ = linearised(after, self.law.value(stroke_V, point.law), context, step)
        remembers = any(effect.linear for effect in through_rest)
        rows = self.rows[number] if step == 1 else slice(None)
        simulated = slice(None) if remembers else rows
        splines, slopes = self.law.columns(stroke_V[simulated])
        slope = slopes @ point.law
        del slopes

        def compared(column: Array) -> Array:
            for effect in through_rest:
                column = effect.through(column, simulated)
            return column[rows] if remembers else column

        starts = self.start_counts(terms)
        base = columns.shape[1] + splines.shape[1]
        count = sum(starts) + sum(len(term.weights) for term in terms)
        tangents = np.zeros((self.series[number].counts[self.rows[number]].size, base + count), order="F")

        def carry(first: int, columns: Array, stack: Sequence[Linearised]) -> None:
            for place, column in enumerate(columns.T, start=first):
                carried = np.ascontiguousarray(column)
                for effect in stack:
                    carried = effect.through(carried)
                tangents[:, place] = compared(slope * carried[simulated])

        carry(0, columns, through_stack)
        for k in range(splines.shape[1]):
            tangents[:, columns.shape[1] + k] = compared(np.ascontiguousarray(splines[:, k]))
        series, first = self.series[number], base + sum(starts[:number])
        carry(first, series.start_columns[::step], through_stack)
        first += series.start_columns.shape[1]
        decays = self.decays(number, terms, point, self.rows[number])
        tangents[:, first : first + decays.shape[1]] = decays
        first = base + sum(starts)
        for term in terms:
            if term.weights and term.effect.columns is not None and term in in_stack:
                own, *later = through_stack[in_stack.index(term) :]
                carry(first, term.effect.columns(own.context, own.values), later)
            first += len(term.weights)
        return tangents


def _rates(series: Sequence[Series]) -> tuple[float, float, float, float]:
    """Rates of the command in recordings: lowest tenth, median, highest tenth, fastest [V/s]."""
    rates = np.concatenate([np.abs(np.diff(recording.command_V)) / recording.dt_s for recording in series])
    moving = rates[rates > 0.0]
    if not moving.size:
        return 1.0, 1.0, 1.0, 1.0
    slow, usual, fast = (float(x) for x in np.percentile(moving, (10, 50, 90)))
    return slow, usual, fast, float(moving.max())


def empty_point(chain: Chain, gain: float, offset_N: float) -> Point:
    """Straight law without hysteresis, from which a fit of the base begins."""
    starts = tuple(np.zeros(count) for count in chain.start_counts(()))
    law = chain.law.straight(offset_N, gain)
    return Point(np.zeros(chain.density.count), law, np.zeros(len(chain.series)), starts=starts)
