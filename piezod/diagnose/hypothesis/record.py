"""What recordings tell about the place and the sense of an effect that was fitted to them."""

import numpy as np

from piezod.diagnose.hypothesis.chain import Chain, Term
from piezod.effects.effect import Record


def record_of(term: Term, chain: Chain) -> Record:
    """Of the recordings asked about, and of the one in which an effect happened once."""
    asked = [one for one in chain.series if one.role == "recording"] or list(chain.series)
    acts_in = chain.series[term.series] if term.scope == "once" else asked[0]
    return Record(
        start_s=acts_in.start_s,
        end_s=acts_in.start_s + acts_in.duration_s,
        longest_s=max(one.duration_s for one in asked),
        dt_s=min(one.dt_s for one in chain.series),
        nyquist_Hz=0.5 / asked[0].dt_s,
        highest_V=max(float(one.command_V.max()) for one in asked),
        fastest_V_per_s=max(float(np.abs(np.diff(one.command_V)).max()) / one.dt_s for one in asked),
        highest={one.name: chain.parameter(term.effect, one.name).high for one in term.effect.parameters},
    )
