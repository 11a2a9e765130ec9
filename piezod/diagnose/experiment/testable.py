"""Which effects a recording could not have shown: it lacks their rates, holds or levels, or the base swallows them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.screening import DIRECT, catalogue_ideas, parts_of
from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.parallel import each
from piezod.effects.effect import Effect

SEEN = 0.04  # of the loss that is left: an effect of usual size that changes less is not seen
ROWS = 6000

Start = tuple[Effect, dict[str, float], tuple[tuple[str, float], ...]]


def untestable(chain: Chain, terms: Sequence[Term], point: Point) -> tuple[str, ...]:
    """Effects of the catalogue that would not have been seen although they were there in their usual size.

    Parameters
    ----------
    chain, terms, point
        Recordings and the hypothesis at the end of the search.

    Returns
    -------
    names
        Of effects none of whose usual sizes changes the readings, beyond what everything that is fitted can follow, by
        as much as a finding must.
    """
    coarse = chain.like(chain.series, ROWS)
    normal = Normal.at(coarse, terms, point)
    asked = [k for k, one in enumerate(coarse.series) if one.role == "recording"]
    left = sum(float(np.sum(normal.weighted[k] ** 2)) for k in asked)
    channels = ["temperature_C"] if all(one.temperature_C is not None for one in coarse.series) else []
    found = {term.effect.name for term in terms}
    starts = [one for one in catalogue_ideas(coarse, channels, {}) if one[0].name not in found]

    def seen(one: Start) -> tuple[str, float]:
        effect, values, choices = one
        term = Term(effect, "since", choices=choices)
        energies = []
        for part in parts_of(effect, values).values():
            given = replace(point, values=(*point.values, part))
            change = [
                coarse.compared(k, (*terms, term), given) - normal.compared[k] if k in asked else None
                for k in range(len(coarse.series))
            ]
            energies.append(normal.free_energy(change))
        return effect.name, max(energies)

    energy: dict[str, float] = {}
    for name, value in each(seen, starts):
        energy[name] = max(energy.get(name, 0.0), value)
    return tuple(name for name, value in energy.items() if value < SEEN * left and name not in DIRECT)
