"""Where an effect acts: the place that its parameters name."""

from collections.abc import Mapping

from piezod.diagnose.findings import Place
from piezod.diagnose.hypothesis.chain import Chain, Term
from piezod.diagnose.hypothesis.record import record_of


def place_of(term: Term, values: Mapping[str, float], chain: Chain) -> tuple[Place, ...]:
    """Places of a fitted effect, none where it acts everywhere.

    Parameters
    ----------
    term
        Effect, and the recording for one that happened once.
    values
        Of its parameters.
    chain
        Recordings.
    """
    where = term.effect.place(values, record_of(term, chain))
    if where is None:
        return ()
    axis, low, high = where
    return (Place(axis, low, max(low, high)),)
