"""Isolability: smallest size at which recordings show an effect, and separate it from each other effect.

Every effect is added to the fitted base in a small size. The part of the change that neither the base nor the other
effect follows determines the size. The isolability of faults is defined likewise (E. Frisk, M. Krysander and D. Jung
(2017), A Toolbox for Analysis and Design of Model Based Diagnosis Systems for Large Scale Models, IFAC-PapersOnLine
50(1)); here for given recordings.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.candidates.starts import DIRECT, Start, catalogue_starts, parts_of, recorded_channels
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Normal, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import best_intersample, coarse
from piezod.diagnose.hypothesis.terms import Point, Setting, Term
from piezod.diagnose.prepare import chain_of, substitute_recording
from piezod.diagnose.selection.given_effects import given_effects
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect, Location
from piezod.estimation.fit.blocks import solved
from piezod.estimation.recordings.preparation import prepared
from piezod.estimation.recordings.sources import Source
from piezod.model import Model

Places = NDArray[np.intp]
Settings = Mapping[str, Setting]  # fitted parameters and choices of effects and their rivals, by name
NEARBY = 1.1  # factor on each parameter of a fitted effect, for the changes by which it may imitate another one
SIGNIFICANT = 3.0  # least difference of two effects [standard deviations]
LARGE = 3.0  # largest size at which effects should be visible and separable [noise rms]; larger ones are obvious
INDEPENDENT = 1e-9  # share of a change below which it is a combination of other changes
VISIBLE = 0.04  # least change by an effect of usual size, relative to the squared residual
ROWS = 6000  # samples of a recording that are compared for `untestable`

BEHIND = {
    Location.AMPLIFIER: "monitor voltage of the amplifier",
    Location.HYSTERESIS: "displacement of the stack",
    Location.STACK: "displacement of the stack",
    Location.MECHANICS: "force of a second load cell",
    Location.LOAD_CELL: "output of the load cell's own amplifier",
}
"""Signal behind a location: recorded too, it separates effects in front of it from those behind it."""


@dataclass(frozen=True)
class Pair:
    """Two effects that the recordings hardly separate."""

    first: str
    second: str
    size: float  # smallest size at which they are separable: rms change of the reading [noise rms]
    separate_by: str  # further channel or experiment that separates them


@dataclass(frozen=True)
class Isolability:
    """Visible and separable sizes of effects.

    Parameters
    ----------
    effects
        Names in the order of the catalogue.
    seen_from
        Smallest visible size of every effect: rms change of the reading [noise rms], shape (effects,).
    separated_from
        Smallest size at which the effects of row and column are separable [noise rms], shape (effects,
        effects); 0 on the diagonal.
    noise
        Rms noise [output unit].
    """

    effects: tuple[str, ...]
    seen_from: Array
    separated_from: Array
    noise: float
    notes: tuple[str, ...]

    @property
    def unseen(self) -> tuple[str, ...]:
        """Effects that are not visible up to a size of `LARGE`."""
        return tuple(name for name, size in zip(self.effects, self.seen_from, strict=True) if size > LARGE)

    def pairs(self) -> list[Pair]:
        """Pairs of visible effects that are not separable up to a size of `LARGE`, the least separable first."""
        hard = np.maximum(self.separated_from, self.separated_from.T)
        hidden = set(self.unseen)
        pairs = [
            Pair(first, second, float(hard[i, j]), separated_by(EFFECTS[first], EFFECTS[second]))
            for i, first in enumerate(self.effects)
            for j, second in enumerate(self.effects)
            if i < j and hard[i, j] > LARGE and not {first, second} & hidden
        ]
        return sorted(pairs, key=lambda pair: -pair.size)

    def groups(self) -> list[tuple[str, ...]]:
        """Groups of effects that are not separable, directly or through other effects."""
        groups = [{name} for name in self.effects]
        for pair in self.pairs():
            joined = [group for group in groups if {pair.first, pair.second} & group]
            groups = [group for group in groups if group not in joined] + [set().union(*joined)]
        order = {name: place for place, name in enumerate(self.effects)}
        inseparable = [tuple(sorted(group, key=order.__getitem__)) for group in groups if len(group) > 1]
        return sorted(inseparable, key=lambda group: order[group[0]])


def separated_by(first: Effect, second: Effect) -> str:
    """Remedy that separates two effects: recording the signal between their locations, otherwise an experiment."""
    front, back = sorted((first.location, second.location))
    if front != back and BEHIND.get(front) != BEHIND.get(back):
        return f"record the {BEHIND[front]} too"
    return first.separate_by


def isolability(
    model: Model,
    recordings: Sequence[Source],
    past: Sequence[Source],
    settings: Settings | None = None,
    only: Collection[str] | None = None,
) -> Isolability:
    """Determine the visible and separable sizes of effects in recordings.

    Parameters
    ----------
    past
        Identification recordings; empty: a recording simulated from the model replaces them.
    settings
        Fitted effects, examined at their size: a short delay resembles a lag more than a long one. Other effects are
        examined at the starts of the catalogue.
    only
        Names of the effects to compare; None: the squares catalogue.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    fitted = {name: setting for name, setting in (settings or {}).items() if only is None or name in only}
    series = prepared([*past, *recordings], model)
    notes = [note for recording in series for note in recording.notes]
    if not past:
        series.insert(0, substitute_recording(model))
    hashes = [""] * (not past) + [source.sha256 for source in (*past, *recordings)]
    chain, start = chain_of(series, model)
    terms, values = given_effects(model, hashes)
    if terms:  # a model with effects states how the command runs between samples
        chain = coarse(chain.like([replace(s, hold=model.hold) for s in series]))
        base = fit(chain, terms, replace(start, values=values))
    else:
        chain, base = best_intersample(coarse(chain), (), start)
        base = fit(chain, (), base.point)
    diagnosed = [s for s in series if s.role == "recording"]
    noise = float(np.sqrt(np.mean(np.square([s.noise_N for s in diagnosed]))))
    names, changes = _changes(chain, base.terms, base.point, fitted, only)
    acting = np.flatnonzero(np.any([change.any(axis=0) for change in changes], axis=0))
    names, changes = [names[k] for k in acting], [change[:, acting] for change in changes]
    if not names:
        return Isolability((), np.zeros(0), np.zeros((0, 0)), noise, tuple(notes))
    normal = Normal.at(chain, base.terms, base.point)
    free, squares = normal.projected(changes)
    samples = float(sum(np.count_nonzero(s.counts) for s in diagnosed))
    effects = tuple(dict.fromkeys(names))
    columns = {effect: np.flatnonzero([name == effect for name in names]) for effect in effects}
    own = {effect: columns[effect][:1] if effect in fitted else columns[effect] for effect in effects}
    seen = np.array([_size(squares[own[e]], np.diag(free)[own[e]], samples) for e in effects])
    separate = np.zeros((len(effects), len(effects)))
    for i, first in enumerate(effects):
        for j, second in enumerate(effects):
            if i != j:
                independent = _independent(free, own[first], columns[second])
                separate[i, j] = _size(squares[own[first]], independent, samples)
    return Isolability(effects, seen, separate, noise, tuple(notes))


def untestable(chain: Chain, terms: Sequence[Term], point: Point) -> tuple[str, ...]:
    """Effects of the catalogue that the recordings would not show in their usual size.

    No usual size changes the readings enough beyond the changes that the fitted parameters follow.
    """
    few = chain.like(chain.series, ROWS)
    normal = Normal.at(few, terms, point)
    residual = sum(
        float(np.sum(weighted**2))
        for weighted, series in zip(normal.weighted, few.series, strict=True)
        if series.role == "recording"
    )
    channels = recorded_channels(few.series)
    only = {name for name, effect in EFFECTS.items() if effect.needs is None or effect.needs in channels}
    names, changes = _changes(few, terms, point, {}, only - {term.effect.name for term in terms})
    energies = np.diag(normal.projected(changes)[0])[:-1]
    visible = {name for name, energy in zip(names, energies, strict=True) if energy >= VISIBLE * residual}
    return tuple(dict.fromkeys(name for name in names if name not in visible))


def _changes(
    chain: Chain, terms: Sequence[Term], point: Point, fitted: Settings, only: Collection[str] | None
) -> tuple[list[str], list[Array]]:
    """Names of the effects, and the change of each recording by each of their starts, shape (rows, starts) [N].

    The change by an effect of the given model adds to that effect.
    """
    diagnosed = [k for k, series in enumerate(chain.series) if series.role == "recording"]
    channels = recorded_channels([chain.series[k] for k in diagnosed])
    before = [chain.compared(k, terms, point) for k in range(len(chain.series))]
    omitted = {*DIRECT, *fitted} if only is None else {*DIRECT, *fitted, *(set(EFFECTS) - set(only))}
    starts = [start for start in catalogue_starts(chain, channels, {}) if start[0].name not in omitted]
    starts += [(EFFECTS[name], *near) for name, setting in fitted.items() for near in _nearby(EFFECTS[name], setting)]

    def changed(start: Start) -> list[list[Array]]:
        effect, values, choices = start
        parts = [values] if effect.name in fitted else parts_of(effect, values).values()
        term = Term(effect, "since", choices=choices)
        return [
            [
                chain.compared(k, (*terms, term), replace(point, values=(*point.values, part))) - before[k]
                if k in diagnosed
                else np.zeros(before[k].size)
                for k in range(len(chain.series))
            ]
            for part in parts
        ]

    parts = [
        (effect.name, part) for (effect, *_), own in zip(starts, each(changed, starts), strict=True) for part in own
    ]
    empty = [np.empty((compared.size, 0)) for compared in before]
    changes = [np.hstack([none, *(part[k][:, None] for _, part in parts)]) for k, none in enumerate(empty)]
    return [name for name, _ in parts], changes


def _nearby(effect: Effect, setting: Setting) -> list[Setting]:
    """Setting, and copies with one parameter changed a little each."""
    values, choices = setting
    moved = [
        {**values, name: float(np.clip(value * NEARBY, effect.parameter(name).low, effect.parameter(name).high))}
        for name, value in values.items()
    ]
    return [(changed, choices) for changed in (values, *moved)]


def _independent(free: Array, changes: Places, others: Places) -> Array:
    """Squared norms of changes that neither the base nor a combination of another effect's changes follows."""
    squares = np.diag(free)[changes]
    across = free[np.ix_(others, changes)]
    followed = np.sum(across * solved(free[np.ix_(others, others)], across), axis=0)
    result: Array = np.clip(squares - followed, 0.0, None)
    return result


def _size(squares: Array, independent: Array, samples: float) -> float:
    """Smallest size at which the independent part is significant in white noise; median over the starts."""
    share = np.clip(independent / np.maximum(squares, 1e-300), INDEPENDENT, 1.0)
    return float(np.median(SIGNIFICANT / np.sqrt(share * samples)))
