"""Where a search may begin: every effect of the catalogue at its starts, and what direct tests suggest."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.direct import peaks_Hz, skew_ppm
from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.parallel import each
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect, Parameter

Array = NDArray[np.float64]

SHIFTED = 0.5  # of the squares: what a shift must bring for a recording to be shifted
SEEN = 1e-6  # of a change's square: what is fitted already must leave so much of it,
APART = 1e-4  # and another one beside it
TOGETHER = 1.1  # times the best gain alone, that two must promise
DIRECT = tuple(name for name, effect in EFFECTS.items() if effect.found_by == "test")


@dataclass(frozen=True)
class Idea:
    """An effect with values to begin from.

    Parameters
    ----------
    term
        Effect, scope and choices.
    values
        Of its searched parameters.
    gain
        By how much it would lower the squared residual in units of the noise, the base refitted; the effect's size
        free, everything to first order.
    """

    term: Term
    values: dict[str, float]
    gain: float = 0.0


def catalogue_ideas(
    chain: Chain, channels: Sequence[str], known: Mapping[str, tuple[float, ...]]
) -> Iterator[tuple[Effect, dict[str, float], tuple[tuple[str, float], ...]]]:
    """Every effect at each of its starts, nuisances at their first one, choices too where that stands for all.

    Starts in volts, volts a second and newtons are parts of what the recordings reach; `known` has further ones.
    """
    scales = {**_scales(chain), **known}
    for effect in EFFECTS.values():
        if effect.name in DIRECT or (effect.needs is not None and effect.needs not in channels):
            continue
        searched = [one for one in effect.parameters if not one.search.choices]
        chosen = [one for one in effect.parameters if one.search.choices]
        starts = [_starts(effect.name, one, scales) for one in searched]
        options = [one.search.choices if one.search.all_screened else one.search.choices[:1] for one in chosen]
        for choices in product(*options):
            named = tuple(zip((one.name for one in chosen), choices, strict=True))
            for values in product(*starts):
                yield effect, dict(zip((one.name for one in searched), values, strict=True)), named


def _scales(chain: Chain) -> dict[str, tuple[float, ...]]:
    """Where searches in these units begin: for limits near the top, for others small parts of the range."""
    top_V = max(float(one.command_V.max()) for one in chain.series if one.role == "recording")
    _, usual, fast, fastest = chain.rates_V_per_s
    span_N = chain.force_span_N
    return {
        "limit_V": tuple(part * top_V for part in (0.5, 0.7, 0.85, 0.95)),
        "knee_V": (0.003 * top_V,),
        "limit_V_per_s": tuple(np.geomspace(0.3 * usual, 0.8 * max(fastest, usual), 10).tolist()),
        "reference_V_per_s": (0.1 * usual, usual, fast),
        "gap_N": tuple(part * span_N for part in (0.01, 0.03, 0.08, 0.16, 0.32, 0.64)),
        "softness_N": (0.002 * span_N,),
        "force_N": (0.005 * span_N,),
        "presliding_N": (0.01 * span_N, 0.04 * span_N, 0.12 * span_N),
    }


def parts_of(effect: Effect, values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Values of every part of an effect that is a sum, each part alone, by what it is the size of; else all at once.

    A sum has no size of its own: it is tried with all its parts beside each other. What shapes a part stays.
    """
    if not effect.parameters[0].search.choices:
        return {"": dict(values)}
    sizes = [name for name in values if not effect.parameter(name).search.logarithmic]
    return {name: {**values, **dict.fromkeys(sizes, 0.0), name: values[name]} for name in sizes}


def _is_a_signed_sum(effect: Effect) -> bool:
    """Whether it adds so much of something, of either sign: from the wrong one what shapes it goes astray first."""
    return effect.form == "additive" and effect.parameters[0].low < 0.0


def _inside(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    return {
        name: float(np.clip(value, effect.parameter(name).low, effect.parameter(name).high))
        for name, value in values.items()
    }


def _starts(effect: str, one: Parameter, scales: dict[str, tuple[float, ...]]) -> tuple[float, ...]:
    known = scales.get(f"{effect} {one.name}", scales.get(one.name)) if effect not in DIRECT else None
    starts = one.search.starts if known is None else tuple(float(np.clip(value, one.low, one.high)) for value in known)
    return starts[:1] if one.search.nuisance else starts


def since(chain: Chain, terms: Sequence[Term], past: Point, lost_N: float) -> list[tuple[Idea, Point]]:
    """Effects that may have come since the model was identified, each at its best start, the most promising first.

    By what remains when a hypothesis runs with them, the recordings shifted onto it or not. `lost_N` is by how much
    their readings stand below: that may be a gap.
    """
    known = {"gap_N": (*_scales(chain)["gap_N"], max(lost_N, 0.0)), **_skews(chain, terms, past)}
    channels = ["temperature_C"] if all(one.temperature_C is not None for one in chain.series) else []

    def looked_at(one: tuple[Effect, dict[str, float], tuple[tuple[str, float], ...]]) -> tuple[Idea, Point]:
        effect, values, choices = one
        term = Term(effect, "since", choices=choices)
        point = replace(past, values=(*past.values, values))
        shifts_N, losses, starts = np.zeros(len(chain.series)), [0.0, 0.0], list(past.starts)
        for number, series in enumerate(chain.series):
            if series.role == "recording":
                rows = chain.rows[number]
                error, told = series.residual(rows, chain.compared(number, (*terms, term), point))
                columns, stroke = _past_columns(chain, number, (*terms, term), point)
                if columns.shape[1]:
                    sizes = np.linalg.lstsq(columns[told > 0.0], error[told > 0.0], rcond=1e-9)[0]
                    error -= columns @ sizes
                    starts[number] = series.noise_N * sizes / stroke
                    starts[number][: past.starts[number].size] += past.starts[number][: sizes.size]
                error = error[told > 0.0]
                losses[0] += float(error @ error)
                losses[1] += float(error.var()) * error.size
                shifts_N[number] = float(error.mean()) * series.noise_N
        shifted = losses[1] < SHIFTED * losses[0]
        start = replace(past, starts=tuple(starts))
        if shifted:
            start = replace(start, offsets_N=past.offsets_N + shifts_N)
        return Idea(term, values, -losses[shifted]), start

    best: dict[str, tuple[Idea, Point]] = {}
    new = (one for one in catalogue_ideas(chain, channels, known) if all(term.effect is not one[0] for term in terms))
    for idea, point in each(looked_at, new):
        name = idea.term.effect.name
        if name not in best or idea.gain > best[name][0].gain:
            best[name] = idea, point
    return sorted(best.values(), key=lambda one: -one[0].gain)


def _past_columns(chain: Chain, number: int, terms: tuple[Term, ...], point: Point) -> tuple[Array, Array]:
    """Columns for the unknown past of a recording, less their means, and what one volt of each gives [N/V or 1]."""
    rows = chain.rows[number]
    of_stroke = chain.series[number].start_columns
    decays = chain.decays(number, terms, point, rows)
    columns = np.hstack((of_stroke[rows], decays)) if of_stroke.size else decays
    stroke = np.ones(columns.shape[1])
    stroke[: of_stroke.shape[1]] = chain.force_span_N / chain.voltage_span_V
    return columns - columns.mean(axis=0), stroke


def _skews(chain: Chain, terms: Sequence[Term], point: Point) -> dict[str, tuple[float, ...]]:
    """Further starts of a skew of the clocks: what the readings show beside what is simulated."""
    seen = [
        skew_ppm(one, chain.run(number, terms, point).reading_N)
        for number, one in enumerate(chain.series)
        if one.role == "recording"
    ]
    starts = EFFECTS["clock_skew"].parameter("skew_ppm").search.starts
    return {"clock_skew skew_ppm": (*starts, *(ppm for ppm in seen if ppm is not None))}


@dataclass(frozen=True)
class _Change:
    """What an idea changes in the readings that are compared, everything to first order.

    Parameters
    ----------
    term, values
        Effect and scope, and what it was looked at with.
    parts
        Multiples of its parts that fit best alone; of one that is no sum 1.
    readings_N
        Change of every recording with these, shape (rows,) [N].
    alone, gain
        The multiple of it that fits best alone, and what that gains, as an idea's.
    """

    term: Term
    values: dict[str, float]
    parts: Array
    readings_N: list[Array]
    alone: float
    gain: float

    def possible(self, multiple: float) -> bool:
        """Whether there can be so much of it."""
        return multiple > 0.0 or self.parts.size > 1 or self.term.effect.parameters[0].low < 0.0

    def idea(self, multiple: float, gain: float) -> Idea:
        """The idea; what is a sum, or adds so much of something, begins with this multiple."""
        effect, names = self.term.effect, list(parts_of(self.term.effect, self.values))
        if len(names) > 1 or _is_a_signed_sum(effect):
            named = names if len(names) > 1 else (effect.parameters[0].name,)
            sizes = {name: multiple * part * self.values[name] for name, part in zip(named, self.parts, strict=True)}
            return Idea(self.term, {**self.values, **_inside(effect, sizes)}, gain)
        return Idea(self.term, self.values, gain)


def screened(chain: Chain, terms: Sequence[Term], point: Point) -> list[Idea]:
    """Every idea that could be added to a fitted hypothesis, the most promising first.

    One finite perturbation an idea, projected off the tangent space of everything that is fitted already.
    """
    _, changes = _changes(chain, terms, point)
    ideas = [one.idea(one.alone, one.gain) for one in changes if one.possible(one.alone)]
    return sorted(ideas, key=lambda idea: -idea.gain)


def screened_pairs(chain: Chain, terms: Sequence[Term], point: Point) -> list[tuple[Idea, Idea]]:
    """Pairs of ideas that promise more together than any idea alone, the most promising first.

    Of every two effects the best pair: each fitted beside the other, which may be what it hides behind.
    """
    normal, changes = _changes(chain, terms, point)
    columns = [np.array([one.readings_N[k] for one in changes]).T for k in range(len(chain.series))]
    free, along, squares = normal.projected(columns)
    own = np.diag(free)
    apart = np.outer(own, own) - free**2
    seen = own > SEEN * squares
    told = seen[:, None] & seen[None, :] & (apart > APART * np.outer(own, own))
    with np.errstate(divide="ignore", invalid="ignore"):
        multiples = (along[:, None] * own[None, :] - along[None, :] * free) / apart  # of the first beside the second
        gains = multiples * along[:, None] + multiples.T * along[None, :]
    alone = max((one.gain for one in changes if one.possible(one.alone)), default=0.0)
    best: dict[tuple[str, str], tuple[Idea, Idea]] = {}
    for first, second in np.argwhere(np.triu(told & (gains > TOGETHER * alone), 1)):
        one, other = changes[first], changes[second]
        names, gain = (one.term.effect.name, other.term.effect.name), float(gains[first, second])
        sizes = float(multiples[first, second]), float(multiples[second, first])
        if names[0] == names[1] or not (one.possible(sizes[0]) and other.possible(sizes[1])):
            continue
        if names not in best or gain > best[names][0].gain:
            best[names] = one.idea(sizes[0], gain), other.idea(sizes[1], gain)
    return sorted(best.values(), key=lambda pair: -pair[0].gain)


def _changes(chain: Chain, terms: Sequence[Term], point: Point) -> tuple[Normal, list[_Change]]:
    """What every idea changes, in both scopes."""
    normal = Normal.at(chain, terms, point)
    channels = ["temperature_C"] if all(one.temperature_C is not None for one in chain.series) else []
    tops_Hz = [
        top
        for one, modelled in zip(chain.series, normal.readings(), strict=True)
        if one.role == "recording"
        for top in peaks_Hz(one, one.reading_N - modelled)
    ]
    ringing = (*tops_Hz, *EFFECTS["resonance"].parameter("frequency_Hz").search.starts)
    known = {"resonance frequency_Hz": ringing, **_skews(chain, terms, point)}

    def looked_at(one: tuple[Effect, dict[str, float], tuple[tuple[str, float], ...]]) -> list[_Change]:
        effect, values, choices = one
        term = Term(effect, "already", choices=choices)
        parts = [
            [
                chain.compared(number, (*terms, term), replace(point, values=(*point.values, part)))
                - normal.compared[number]
                for number in range(len(chain.series))
            ]
            for part in parts_of(effect, values).values()
        ]
        changes = []
        for scope in ("since", "already"):
            term = Term(effect, scope, choices=choices)
            acts = [term.acts_on(k, series) for k, series in enumerate(chain.series)]
            acting = [[c if acts[k] else np.zeros_like(c) for k, c in enumerate(part)] for part in parts]
            gain, sizes = normal.gain_of(acting)
            multiples, alone = (sizes, 1.0) if sizes.size > 1 else (np.ones(1), float(sizes[0]))
            readings_N = [multiples @ np.array([part[k] for part in acting]) for k in range(len(chain.series))]
            changes.append(_Change(term, values, multiples, readings_N, alone, gain))
        return changes

    new = [one for one in catalogue_ideas(chain, channels, known) if not any(term.effect is one[0] for term in terms)]
    return normal, [change for changes in each(looked_at, new) for change in changes]
