"""Place of an effect: the voltages, times or frequencies that its parameters give."""

from collections.abc import Mapping

from piezod.diagnose.findings import Place
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.record import record_of
from piezod.diagnose.hypothesis.terms import Term


def place_of(term: Term, values: Mapping[str, float], chain: Chain) -> tuple[Place, ...]:
    """Place of a fitted effect with these parameter values; empty if it acts everywhere."""
    where = term.effect.place(values, record_of(term, chain))
    if where is None:
        return ()
    axis, low, high = where
    return (Place(axis, low, max(low, high)),)
