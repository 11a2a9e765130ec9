"""Effects that recordings cannot show: they lack the rates, holds or levels, or the fitted base follows the effect."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.starts import DIRECT, Start, catalogue_starts, parts_of, recorded_channels
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.terms import Point, Term

VISIBLE = 0.04  # least change by an effect of usual size, relative to the squared residual
ROWS = 6000  # samples of a recording that are compared


def untestable(chain: Chain, terms: Sequence[Term], point: Point) -> tuple[str, ...]:
    """Effects of the catalogue that the recordings would not show in their usual size.

    No usual size changes the readings enough beyond the changes that the fitted parameters follow.
    """
    coarse = chain.like(chain.series, ROWS)
    normal = Normal.at(coarse, terms, point)
    diagnosed = [k for k, series in enumerate(coarse.series) if series.role == "recording"]
    residual = sum(float(np.sum(normal.weighted[k] ** 2)) for k in diagnosed)
    names = {term.effect.name for term in terms}
    starts = catalogue_starts(coarse, recorded_channels(coarse.series), {})
    new = [start for start in starts if start[0].name not in names]

    def energy_of(start: Start) -> tuple[str, float]:
        effect, values, choices = start
        term = Term(effect, "since", choices=choices)
        energies = []
        for part in parts_of(effect, values).values():
            given = replace(point, values=(*point.values, part))
            change = [
                coarse.compared(k, (*terms, term), given) - normal.compared[k] if k in diagnosed else None
                for k in range(len(coarse.series))
            ]
            energies.append(normal.free_energy(change))
        return effect.name, max(energies)

    energy: dict[str, float] = {}
    for name, value in each(energy_of, new):
        energy[name] = max(energy.get(name, 0.0), value)
    return tuple(name for name, value in energy.items() if value < VISIBLE * residual and name not in DIRECT)
