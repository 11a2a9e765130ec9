"""What recordings can tell: from which size on an effect is seen, and told from each other effect.

Every effect is added to the fitted base in a small size. What the base and the other effect cannot follow of the change
decides, as in the isolability of faults (E. Frisk, M. Krysander and D. Jung (2017), A Toolbox for Analysis and Design
of Model Based Diagnosis Systems for Large Scale Models, IFAC-PapersOnLine 50(1)), here for one given record.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.screening import DIRECT, catalogue_ideas, parts_of
from piezod.diagnose.hypothesis.chain import Chain, Setting, Term
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import best_course, coarse
from piezod.diagnose.prepare import Source, chain_of, made_ready, stand_in
from piezod.diagnose.selection.given_effects import given_effects
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect, Location
from piezod.model import Model

Array = NDArray[np.float64]
Places = NDArray[np.intp]
Found = Mapping[str, Setting]
"""Effects that a diagnosis found, and their rivals, each as it was fitted."""

NEARBY = 1.1
"""Factor by which each parameter of a found effect is moved, for the changes that another effect may imitate with."""

SURE = 3.0
"""Standard deviations by which two effects must differ."""

LARGE = 3.0
"""Size, in noises, up to which an effect should be seen and separated: a larger one is seen by eye."""

INDEPENDENT = 1e-9
"""Share of a change below which it is a combination of others."""

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
    """Two effects that look alike in the recordings.

    Parameters
    ----------
    first, second
        Names of the effects.
    size
        Smallest size from which on they are told from each other: rms of the change of the reading, in noises.
    separate_by
        What would separate them: a further channel, or an experiment.
    """

    first: str
    second: str
    size: float
    separate_by: str


@dataclass(frozen=True)
class Isolability:
    """What recordings can tell.

    Parameters
    ----------
    effects
        Names, in the order of the catalogue.
    seen_from
        Of every effect, its smallest size that is seen beside the base: rms of the change of the reading, in noises.
    separated_from
        Smallest size from which on the effect of the row is told from that of the column, shape (effects, effects), in
        noises; 0 on the diagonal.
    noise
        Rms of the noise [output unit].
    notes
        What was noticed in the recordings.
    """

    effects: tuple[str, ...]
    seen_from: Array
    separated_from: Array
    noise: float
    notes: tuple[str, ...]

    @property
    def unseen(self) -> tuple[str, ...]:
        """Effects that are not seen up to a size of `LARGE`."""
        return tuple(name for name, size in zip(self.effects, self.seen_from, strict=True) if size > LARGE)

    def pairs(self) -> list[Pair]:
        """Pairs of effects that are seen, but not separated up to a size of `LARGE`; the least separable first."""
        hard = np.maximum(self.separated_from, self.separated_from.T)
        hidden = set(self.unseen)
        found = [
            Pair(one, other, float(hard[i, j]), separated_by(EFFECTS[one], EFFECTS[other]))
            for i, one in enumerate(self.effects)
            for j, other in enumerate(self.effects)
            if i < j and hard[i, j] > LARGE and not {one, other} & hidden
        ]
        return sorted(found, key=lambda pair: -pair.size)

    def groups(self) -> list[tuple[str, ...]]:
        """Effects that cannot be separated, directly or through each other; each in one group."""
        groups = [{name} for name in self.effects]
        for pair in self.pairs():
            joined = [group for group in groups if {pair.first, pair.second} & group]
            groups = [group for group in groups if group not in joined] + [set().union(*joined)]
        order = {name: place for place, name in enumerate(self.effects)}
        inseparable = [tuple(sorted(group, key=order.__getitem__)) for group in groups if len(group) > 1]
        return sorted(inseparable, key=lambda group: order[group[0]])


def separated_by(one: Effect, other: Effect) -> str:
    """What separates two effects: the signal between their locations, else an experiment.

    Parameters
    ----------
    one, other
        Of the catalogue.
    """
    first, last = sorted((one.location, other.location))
    if first != last and BEHIND.get(first) != BEHIND.get(last):
        return f"record the {BEHIND[first]} too"
    return one.separate_by


def isolability(
    model: Model,
    asked: Sequence[Source],
    past: Sequence[Source],
    found: Found | None = None,
    only: Collection[str] | None = None,
) -> Isolability:
    """Determine what recordings can tell.

    Parameters
    ----------
    model
        Identified model.
    asked
        Recordings in which an effect might be sought.
    past
        Recordings that the model was identified on; none: a simulation of it replaces them.
    found
        Effects in the size in which they were found: a short delay is more like a lag than a long one. The others are
        taken at the starts of the catalogue.
    only
        Names of the effects to compare; None: the whole catalogue.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    found = {name: one for name, one in (found or {}).items() if only is None or name in only}
    series, _, notes = made_ready([*past, *asked], model)
    if not past:
        series.insert(0, stand_in(model))
    hashes = [""] * (not past) + [source.sha256 for source in (*past, *asked)]
    chain, start = chain_of(series, model)
    terms, values = given_effects(model, hashes)
    if terms:  # a model with effects states how the command runs between samples
        chain = coarse(chain.like([replace(one, hold=model.hold) for one in series]))
        base = fit(chain, terms, replace(start, values=values))
    else:
        chain, base = best_course(coarse(chain), (), start)
        base = fit(chain, (), base.point)
    noises = [one.noise_N for one in series if one.role == "recording"]
    noise = float(np.sqrt(np.mean(np.square(noises))))
    names, changes = _changes(chain, base, found, only)
    if not names:
        return Isolability((), np.zeros(0), np.zeros((0, 0)), noise, tuple(notes))
    normal = Normal.at(chain, base.terms, base.point)
    free, _, whole = normal.projected(changes)
    samples = float(sum(np.count_nonzero(one.counts) for one in series if one.role == "recording"))
    effects = tuple(dict.fromkeys(names))
    columns = {effect: np.flatnonzero([name == effect for name in names]) for effect in effects}
    own = {effect: columns[effect][:1] if effect in found else columns[effect] for effect in effects}
    sure = np.array([_size(whole[own[e]], np.diag(free)[own[e]], samples) for e in effects])
    separate = np.zeros((len(effects), len(effects)))
    for i, first in enumerate(effects):
        for j, second in enumerate(effects):
            if i != j:
                left = _left(free, own[first], columns[second])
                separate[i, j] = _size(whole[own[first]], left, samples)
    return Isolability(effects, sure, separate, noise, tuple(notes))


def _changes(chain: Chain, base: Fitted, found: Found, only: Collection[str] | None) -> tuple[list[str], list[Array]]:
    """Names, and what each start of every effect changes in each recording, shape (rows, starts) [N].

    What an effect of the given model changes is added to what it does there.
    """
    point = base.point
    asked = [k for k, one in enumerate(chain.series) if one.role == "recording"]
    channels = ["temperature_C"] if all(chain.series[k].temperature_C is not None for k in asked) else []
    before = [chain.compared(k, base.terms, point) for k in range(len(chain.series))]
    left_out = {*DIRECT, *found} if only is None else {*DIRECT, *found, *(set(EFFECTS) - set(only))}
    starts = [one for one in catalogue_ideas(chain, channels, {}) if one[0].name not in left_out]
    starts += [(EFFECTS[name], *start) for name, one in found.items() for start in _nearby(EFFECTS[name], one)]

    def changed(one: tuple[Effect, dict[str, float], tuple[tuple[str, float], ...]]) -> list[list[Array]]:
        effect, values, choices = one
        parts = [values] if effect.name in found else parts_of(effect, values).values()
        term = Term(effect, "since", choices=choices)
        return [
            [
                chain.compared(k, (*base.terms, term), replace(point, values=(*point.values, part))) - before[k]
                if k in asked
                else np.zeros(before[k].size)
                for k in range(len(chain.series))
            ]
            for part in parts
        ]

    names, columns = [], []
    for (effect, _, _), parts in zip(starts, each(changed, starts), strict=True):
        for part in parts:
            if any(change.any() for change in part):
                names.append(effect.name)
                columns.append(part)
    return names, [np.array([part[k] for part in columns]).T for k in range(len(chain.series))]


def _nearby(effect: Effect, setting: Setting) -> list[Setting]:
    """A setting, and it with each of its parameters moved a little."""
    values, choices = setting
    moved = [
        {**values, name: float(np.clip(value * NEARBY, effect.parameter(name).low, effect.parameter(name).high))}
        for name, value in values.items()
    ]
    return [(one, choices) for one in (values, *moved)]


def _left(free: Array, of: Places, beside: Places) -> Array:
    """Squares of changes that neither the base nor any combination of another effect's changes can follow."""
    own = np.diag(free)[of]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(free)[beside], 1e-300))
    inner = free[np.ix_(beside, beside)] * np.outer(scale, scale)
    across = free[np.ix_(of, beside)] * scale
    followed = np.einsum("ij,jk,ik->i", across, np.linalg.pinv(inner, rcond=INDEPENDENT, hermitian=True), across)
    left: Array = np.clip(own - followed, 0.0, None)
    return left


def _size(whole: Array, left: Array, samples: float) -> float:
    """Smallest size at which what is left is sure in white noise: of an effect's starts the median one."""
    share = np.clip(left / np.maximum(whole, 1e-300), INDEPENDENT, 1.0)
    return float(np.median(SURE / np.sqrt(share * samples)))
