"""Quantities of the recordings that the place and the plausibility of a fitted effect depend on, and its place."""

from collections.abc import Mapping

import numpy as np

from piezod.diagnose.findings import Place
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.terms import Term
from piezod.effects.effect import Record


def record_of(term: Term, chain: Chain) -> Record:
    """Record of the recordings to explain; its times are those of the recording that a term acts in."""
    recordings = [series for series in chain.series if series.role == "recording"] or list(chain.series)
    acts_in = chain.series[term.series] if term.scope == "once" else recordings[0]
    return Record(
        start_s=acts_in.start_s,
        end_s=acts_in.start_s + acts_in.duration_s,
        longest_s=max(series.duration_s for series in recordings),
        dt_s=min(series.dt_s for series in chain.series),
        nyquist_Hz=0.5 / recordings[0].dt_s,
        highest_V=max(float(series.command_V.max()) for series in recordings),
        fastest_V_per_s=max(float(np.abs(np.diff(series.command_V)).max()) / series.dt_s for series in recordings),
        highest={known.name: chain.parameter(term.effect, known.name).high for known in term.effect.parameters},
    )


def place_of(term: Term, values: Mapping[str, float], chain: Chain) -> tuple[Place, ...]:
    """Place of a fitted effect with these parameter values; empty if it acts everywhere."""
    where = term.effect.place(values, record_of(term, chain))
    if where is None:
        return ()
    axis, low, high = where
    return (Place(axis, low, max(low, high)),)
