"""Screening: the first-order gain of every effect of the catalogue at its starts, and of pairs of effects."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.direct import peaks_Hz, skew_ppm
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect, Parameter
from piezod.estimation.recordings.series import Series

Array = NDArray[np.float64]

SHIFTED = 0.5  # largest loss ratio with a free offset at which the offset is used
INDEPENDENT = 1e-6  # least share of a change that the fitted parameters do not follow
INDEPENDENT_PAIR = 1e-4  # least share of a change that another one does not follow either
PAIR_GAIN = 1.1  # least gain of a pair over the best single gain
DIRECT = tuple(name for name, effect in EFFECTS.items() if effect.found_by == "test")


Start = tuple[Effect, dict[str, float], tuple[tuple[str, float], ...]]
"""Effect, start values of its searched parameters, and choices."""


@dataclass(frozen=True)
class Candidate:
    """Effect with start values.

    Parameters
    ----------
    term
        Effect, scope and choices.
    values
        Start values of its searched parameters.
    gain
        Fall of the squared residual to first order, with the base and the size of the effect fitted [noise variance].
    """

    term: Term
    values: dict[str, float]
    gain: float = 0.0


def catalogue_starts(chain: Chain, channels: Sequence[str], known: Mapping[str, tuple[float, ...]]) -> Iterator[Start]:
    """Every effect of the catalogue at each combination of its starts and choices.

    Nuisance parameters have their first start only, and choices that are not screened their first value. `known`:
    further starts by parameter.
    """
    scales = {**_scales(chain), **known}
    for effect in EFFECTS.values():
        if effect.name in DIRECT or (effect.needs is not None and effect.needs not in channels):
            continue
        searched = [p for p in effect.parameters if not p.search.choices]
        chosen = [p for p in effect.parameters if p.search.choices]
        starts = [_starts(effect.name, p, scales) for p in searched]
        options = [p.search.choices if p.search.all_screened else p.search.choices[:1] for p in chosen]
        for choices in product(*options):
            named = tuple(zip((p.name for p in chosen), choices, strict=True))
            for values in product(*starts):
                yield effect, dict(zip((p.name for p in searched), values, strict=True)), named


def recorded_channels(series: Sequence[Series]) -> list[str]:
    """Further channels that all recordings have and an effect may need."""
    return ["temperature_C"] if all(s.temperature_C is not None for s in series) else []


def _scales(chain: Chain) -> dict[str, tuple[float, ...]]:
    """Starts by parameter: limits near the highest command or rate, other parameters at small parts of the range."""
    top_V = max(float(s.command_V.max()) for s in chain.series if s.role == "recording")
    _, median, fast, fastest = chain.rates_V_per_s
    span_N = chain.force_span_N
    return {
        "limit_V": tuple(part * top_V for part in (0.5, 0.7, 0.85, 0.95)),
        "knee_V": (0.003 * top_V,),
        "limit_V_per_s": tuple(np.geomspace(0.3 * median, 0.8 * max(fastest, median), 10).tolist()),
        "reference_V_per_s": (0.1 * median, median, fast),
        "gap_N": tuple(part * span_N for part in (0.01, 0.03, 0.08, 0.16, 0.32, 0.64)),
        "softness_N": (0.002 * span_N,),
        "force_N": (0.005 * span_N,),
        "presliding_N": (0.01 * span_N, 0.04 * span_N, 0.12 * span_N),
    }


def parts_of(effect: Effect, values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Values of each part of an effect that is a sum, with the sizes of the other parts 0; otherwise all values.

    A sum has no single size, so its parts are fitted together. The key is the size parameter of the part.
    """
    if not effect.parameters[0].search.choices:
        return {"": dict(values)}
    sizes = [name for name in values if not effect.parameter(name).search.logarithmic]
    return {name: {**values, **dict.fromkeys(sizes, 0.0), name: values[name]} for name in sizes}


def _is_a_signed_sum(effect: Effect) -> bool:
    """Whether an effect adds a signal of either sign; a fit from the wrong sign would bend its shape first."""
    return effect.form == "additive" and effect.parameters[0].low < 0.0


def within_ranges(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Values, limited to the ranges of the effect's parameters."""
    return {
        name: float(np.clip(value, effect.parameter(name).low, effect.parameter(name).high))
        for name, value in values.items()
    }


def _starts(effect: str, parameter: Parameter, scales: dict[str, tuple[float, ...]]) -> tuple[float, ...]:
    known = scales.get(f"{effect} {parameter.name}", scales.get(parameter.name)) if effect not in DIRECT else None
    starts = parameter.search.starts
    if known is not None:
        starts = tuple(float(np.clip(value, parameter.low, parameter.high)) for value in known)
    return starts[:1] if parameter.search.nuisance else starts


def since_identification(
    chain: Chain, terms: Sequence[Term], past: Point, offset_N: float
) -> list[tuple[Candidate, Point]]:
    """Effects that may have appeared after the identification, each at its best start, the best first.

    Each is simulated with the base of the identification, with or without a free offset of the recordings.

    Parameters
    ----------
    chain, terms
        Recordings and current effects.
    past
        Base of the identification with the values of the effects.
    offset_N
        Fall of the readings since the identification, which may be a gap [N].
    """
    known = {"gap_N": (*_scales(chain)["gap_N"], max(offset_N, 0.0)), **_skews(chain, terms, past)}

    def simulated(start: Start) -> tuple[Candidate, Point]:
        effect, values, choices = start
        term = Term(effect, "since", choices=choices)
        point = replace(past, values=(*past.values, values))
        shifts_N, losses, starts = np.zeros(len(chain.series)), [0.0, 0.0], list(past.starts)
        for number, series in enumerate(chain.series):
            if series.role == "recording":
                rows = chain.rows[number]
                error, weights = series.residual(rows, chain.compared(number, (*terms, term), point))
                columns, stroke = _past_columns(chain, number, (*terms, term), point)
                compared = weights > 0.0
                if columns.shape[1]:
                    sizes = np.linalg.lstsq(columns[compared], error[compared], rcond=1e-9)[0]
                    error -= columns @ sizes
                    starts[number] = series.noise_N * sizes / stroke
                    starts[number][: past.starts[number].size] += past.starts[number][: sizes.size]
                error = error[compared]
                losses[0] += float(error @ error)
                losses[1] += float(error.var()) * error.size
                shifts_N[number] = float(error.mean()) * series.noise_N
        shifted = losses[1] < SHIFTED * losses[0]
        begin = replace(past, starts=tuple(starts))
        if shifted:
            begin = replace(begin, offsets_N=past.offsets_N + shifts_N)
        return Candidate(term, values, -losses[shifted]), begin

    best: dict[str, tuple[Candidate, Point]] = {}
    for candidate, point in each(simulated, _new_starts(chain, terms, known)):
        name = candidate.term.effect.name
        if name not in best or candidate.gain > best[name][0].gain:
            best[name] = candidate, point
    return sorted(best.values(), key=lambda pair: -pair[0].gain)


def _new_starts(chain: Chain, terms: Sequence[Term], known: Mapping[str, tuple[float, ...]]) -> list[Start]:
    """Starts of all effects that are not among the terms."""
    starts = catalogue_starts(chain, recorded_channels(chain.series), known)
    return [start for start in starts if all(term.effect is not start[0] for term in terms)]


def _past_columns(chain: Chain, number: int, terms: tuple[Term, ...], point: Point) -> tuple[Array, Array]:
    """Columns for the unknown past of a recording without their means, and the force per unit of each [N/V or 1]."""
    rows = chain.rows[number]
    stroke_columns = chain.series[number].start_columns
    decays = chain.decays(number, terms, point, rows)
    columns = np.hstack((stroke_columns[rows], decays)) if stroke_columns.size else decays
    stroke = np.ones(columns.shape[1])
    stroke[: stroke_columns.shape[1]] = chain.force_span_N / chain.voltage_span_V
    return columns - columns.mean(axis=0), stroke


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
class _Change:
    """Change of the compared readings by an effect at a start.

    Parameters
    ----------
    term, values
        Effect with its scope, and start values.
    parts
        Best multiples of its parts without another effect; 1 for an effect that is no sum.
    readings_N
        Change of every recording with these multiples, shape (rows,) each [N].
    alone, gain
        Best multiple without another effect, and its gain.
    """

    term: Term
    values: dict[str, float]
    parts: Array
    readings_N: list[Array]
    alone: float
    gain: float

    def possible(self, multiple: float) -> bool:
        """Whether the effect can have this multiple of its size."""
        return multiple > 0.0 or self.parts.size > 1 or self.term.effect.parameters[0].low < 0.0

    def candidate(self, multiple: float, gain: float) -> Candidate:
        """Candidate; a sum and an effect of either sign start with this multiple of their sizes."""
        effect, names = self.term.effect, list(parts_of(self.term.effect, self.values))
        if len(names) > 1 or _is_a_signed_sum(effect):
            named = names if len(names) > 1 else (effect.parameters[0].name,)
            sizes = {name: multiple * part * self.values[name] for name, part in zip(named, self.parts, strict=True)}
            return Candidate(self.term, {**self.values, **within_ranges(effect, sizes)}, gain)
        return Candidate(self.term, self.values, gain)


def screened(chain: Chain, terms: Sequence[Term], point: Point) -> list[Candidate]:
    """Candidates for one more effect in a fitted hypothesis, the largest gain first.

    Each start is one finite change, projected off the tangent space of all fitted parameters.
    """
    _, changes = _changes(chain, terms, point)
    candidates = [change.candidate(change.alone, change.gain) for change in changes if change.possible(change.alone)]
    return sorted(candidates, key=lambda candidate: -candidate.gain)


def screened_pairs(chain: Chain, terms: Sequence[Term], point: Point) -> list[tuple[Candidate, Candidate]]:
    """Pairs of candidates that gain more together than any candidate alone, the largest gain first.

    For every two effects, the best pair of their starts, fitted together.
    """
    normal, changes = _changes(chain, terms, point)
    columns = [np.array([change.readings_N[k] for change in changes]).T for k in range(len(chain.series))]
    free, along, squares = normal.projected(columns)
    own = np.diag(free)
    determinants = np.outer(own, own) - free**2
    independent = own > INDEPENDENT * squares
    pairs = independent[:, None] & independent[None, :] & (determinants > INDEPENDENT_PAIR * np.outer(own, own))
    with np.errstate(divide="ignore", invalid="ignore"):
        multiples = (along[:, None] * own[None, :] - along[None, :] * free) / determinants  # of the first
        gains = multiples * along[:, None] + multiples.T * along[None, :]
    alone = max((change.gain for change in changes if change.possible(change.alone)), default=0.0)
    best: dict[tuple[str, str], tuple[Candidate, Candidate]] = {}
    for i, j in np.argwhere(np.triu(pairs & (gains > PAIR_GAIN * alone), 1)):
        first, second = changes[i], changes[j]
        names, gain = (first.term.effect.name, second.term.effect.name), float(gains[i, j])
        sizes = float(multiples[i, j]), float(multiples[j, i])
        if names[0] == names[1] or not (first.possible(sizes[0]) and second.possible(sizes[1])):
            continue
        if names not in best or gain > best[names][0].gain:
            best[names] = first.candidate(sizes[0], gain), second.candidate(sizes[1], gain)
    return sorted(best.values(), key=lambda pair: -pair[0].gain)


def _changes(chain: Chain, terms: Sequence[Term], point: Point) -> tuple[Normal, list[_Change]]:
    """Normal equations of the hypothesis, and the change by every start in both scopes."""
    normal = Normal.at(chain, terms, point)
    modes_Hz = [
        peak_Hz
        for series, modelled in zip(chain.series, normal.readings(), strict=True)
        if series.role == "recording"
        for peak_Hz in peaks_Hz(series, series.reading_N - modelled)
    ]
    known = {key: (*modes_Hz, *starts) for key, starts in _starts_seen_in("spectrum").items()}
    known |= _skews(chain, terms, point)

    def changes_by(start: Start) -> list[_Change]:
        effect, values, choices = start
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

    starts = _new_starts(chain, terms, known)
    return normal, [change for changes in each(changes_by, starts) for change in changes]
