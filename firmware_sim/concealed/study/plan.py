"""Which cases a study has: nulls, singles of every effect evenly, pairs, triples, and effects in no catalogue."""

from typing import Generic, TypeVar

import numpy as np

from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.drawing import NOISE_SHARES, STRENGTHS, Wish

KINDS = ("null", "single", "pair", "triple", "foreign")
SHARES = {"null": 0.26, "single": 0.34, "pair": 0.2, "triple": 0.08, "foreign": 0.12}
T = TypeVar("T")

WITH_COMPANY = 0.2  # of the foreign effects have one of the catalogue beside them


def wishes(rng: np.random.Generator, cases: int, kind: str, effect: str | None, strength: float | None) -> list[Wish]:
    """Wishes for a study, in random order.

    Parameters
    ----------
    rng
        Its random numbers.
    cases
        How many.
    kind
        One of `KINDS`, or `all`.
    effect
        The one that is in every case that is no null; None: every one in turn.
    strength
        The one wanted; None: every one in turn.
    """
    kinds = _kinds(cases) if kind == "all" else [kind] * cases
    catalogue, foreign = _Turns(rng, tuple(ENTRIES)), _Turns(rng, tuple(FOREIGN))
    strengths, noises = {name: _Turns(rng, STRENGTHS) for name in (*ENTRIES, *FOREIGN)}, tuple(NOISE_SHARES)
    result = []
    for each in kinds:
        names = _names(rng, each, catalogue, foreign, effect)
        wanted = tuple(strengths[name].next() if strength is None else strength for name in names)
        noise = str(rng.choice(noises, p=list(NOISE_SHARES.values())))
        result.append(Wish(each, names, wanted, noise))
    return [result[k] for k in rng.permutation(cases)]


def _kinds(cases: int) -> list[str]:
    """Whole numbers of each kind, the null's rounded up, what is left over to the singles."""
    counts = {kind: int(share * cases) for kind, share in SHARES.items()}
    counts["null"] = -int(-0.25 * cases // 1) if cases < 50 else counts["null"]
    counts["single"] += cases - sum(counts.values())
    return [kind for kind, count in counts.items() for _ in range(count)]


def _names(
    rng: np.random.Generator, kind: str, catalogue: "_Turns[str]", foreign: "_Turns[str]", effect: str | None
) -> tuple[str, ...]:
    count = {"null": 0, "single": 1, "pair": 2, "triple": 3, "foreign": 0}[kind]
    names = [] if effect is None or count == 0 or effect in FOREIGN else [effect]
    if kind == "foreign":
        names = [effect if effect in FOREIGN else foreign.next()]
        count = 1 + int(rng.random() < WITH_COMPANY)
    while len(names) < count:
        name = catalogue.next() if kind == "single" else str(rng.choice(tuple(ENTRIES)))
        if name not in names:
            names.append(name)
    return tuple(names)


class _Turns(Generic[T]):
    """Each of some things in turn, in an order that is shuffled anew every round."""

    def __init__(self, rng: np.random.Generator, things: tuple[T, ...]) -> None:
        self._rng, self._things = rng, things
        self._left: list[T] = []

    def next(self) -> T:
        if not self._left:
            self._left = [self._things[k] for k in self._rng.permutation(len(self._things))]
        return self._left.pop()
