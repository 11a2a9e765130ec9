"""Starts of a search: every effect of the catalogue at each combination of its start values and choices."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.terms import Term
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect
from piezod.estimation.recordings.series import Series

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
    """

    term: Term
    values: dict[str, float]


def catalogue_starts(chain: Chain, channels: Sequence[str], known: Mapping[str, tuple[float, ...]]) -> Iterator[Start]:
    """Every effect of the catalogue at each combination of its starts and choices.

    Nuisance parameters have their first start only. `known`: further starts by parameter.
    """
    for effect in EFFECTS.values():
        if effect.name in DIRECT or (effect.needs is not None and effect.needs not in channels):
            continue
        searched = [p for p in effect.parameters if not p.search.choices]
        chosen = [p for p in effect.parameters if p.search.choices]
        limits = {f"{effect.name} {p.name}": (p.low, p.high) for p in searched}
        shown = {name: np.clip(known[name], *ends).tolist() for name, ends in limits.items() if name in known}
        starts = [shown.get(f"{effect.name} {p.name}", p.starts(chain.driven)) for p in searched]
        options = [p.search.choices for p in chosen]
        for choices in product(*options):
            named = tuple(zip((p.name for p in chosen), choices, strict=True))
            for values in product(*starts):
                yield effect, dict(zip((p.name for p in searched), values, strict=True)), named


def recorded_channels(series: Sequence[Series]) -> list[str]:
    """Further channels that all recordings have and an effect may need."""
    return ["temperature_C"] if all(s.temperature_C is not None for s in series) else []


def parts_of(effect: Effect, values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Values of each part of an effect that is a sum, with the sizes of the other parts 0; otherwise all values.

    A sum has no single size, so its parts are fitted together. The key is the size parameter of the part.
    """
    if not effect.parameters[0].search.choices:
        return {"": dict(values)}
    sizes = [name for name in values if not effect.parameter(name).search.logarithmic]
    return {name: {**values, **dict.fromkeys(sizes, 0.0), name: values[name]} for name in sizes}


def within_ranges(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Values, limited to the ranges of the effect's parameters."""
    return {
        name: float(np.clip(value, effect.parameter(name).low, effect.parameter(name).high))
        for name, value in values.items()
    }
