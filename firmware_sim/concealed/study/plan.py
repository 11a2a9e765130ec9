"""Plan of a study: the number of cases of each kind, and their effects."""

from collections.abc import Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.plant.second_input import OUTSIDE_CATALOGUE, SECOND_INPUTS
from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.drawing import NOISE_SHARES, STRENGTHS, CaseSpec

KINDS = ("null", "single", "pair", "triple", "foreign", "unrecorded")
"""`foreign`: an effect outside the catalogue. `unrecorded`: a second input that no file records."""

SHARES = {"null": 0.26, "single": 0.34, "pair": 0.2, "triple": 0.08, "foreign": 0.12}
VARIED_SHARES = {kind: 0.9 * share for kind, share in SHARES.items()} | {"unrecorded": 0.1}
T = TypeVar("T")

WITH_COMPANION = 0.2  # share of the foreign cases with a catalogue effect beside the foreign one


def case_specs(
    rng: np.random.Generator,
    cases: int,
    kind: str,
    effect: str | None,
    strength: float | None,
    families: Sequence[str] = ("",),
    *,
    varied: bool = False,
) -> list[CaseSpec]:
    """Specifications of the cases of a study, in random order.

    Parameters
    ----------
    rng
        Random numbers of the plan.
    kind
        One of `KINDS`, or `all`.
    effect
        Effect of every case except nulls; None: every effect in turn.
    strength
        Strength of the effects [noise rms]; None: every one of `STRENGTHS` in turn.
    families
        Families of the plants, in turn; empty text: laws drawn for each case.
    varied
        Whether the benches are varied.
    """
    kinds = _kinds(cases, VARIED_SHARES if varied else SHARES) if kind == "all" else [kind] * cases
    catalogue, foreign = _Turns(rng, tuple(ENTRIES)), _Turns(rng, tuple(FOREIGN))
    strengths, noises = {name: _Turns(rng, STRENGTHS) for name in (*ENTRIES, *OUTSIDE_CATALOGUE)}, tuple(NOISE_SHARES)
    result = []
    for number, each in enumerate(kinds):
        names = _names(rng, each, catalogue, foreign, effect)
        chosen = tuple(strengths[name].next() if strength is None else strength for name in names)
        noise = str(rng.choice(noises, p=list(NOISE_SHARES.values())))
        result.append(CaseSpec(each, names, chosen, noise, families[number % len(families)], varied))
    return [result[k] for k in rng.permutation(cases)]


def _kinds(cases: int, shares: Mapping[str, float]) -> list[str]:
    """Kinds of all cases; below 50 cases the number of nulls is rounded up. Singles take the remainder."""
    counts = {kind: int(share * cases) for kind, share in shares.items()}
    counts["null"] = -int(-0.25 * cases // 1) if cases < 50 else counts["null"]
    counts["single"] += cases - sum(counts.values())
    return [kind for kind, count in counts.items() for _ in range(count)]


def _names(
    rng: np.random.Generator, kind: str, catalogue: "_Turns[str]", foreign: "_Turns[str]", effect: str | None
) -> tuple[str, ...]:
    """Names of the effects of one case."""
    count = {"null": 0, "single": 1, "pair": 2, "triple": 3}.get(kind, 0)
    names = [] if effect is None or count == 0 or effect in OUTSIDE_CATALOGUE else [effect]
    if kind == "unrecorded":
        return tuple(SECOND_INPUTS)
    if kind == "foreign":
        names = [effect if effect in FOREIGN else foreign.next()]
        count = 1 + int(rng.random() < WITH_COMPANION)
    while len(names) < count:
        name = catalogue.next() if kind == "single" else str(rng.choice(tuple(ENTRIES)))
        if name not in names:
            names.append(name)
    return tuple(names)


class _Turns(Generic[T]):
    """Returns every item once per round, in an order that is shuffled for every round."""

    def __init__(self, rng: np.random.Generator, items: tuple[T, ...]) -> None:
        self._rng, self._items = rng, items
        self._remaining: list[T] = []

    def next(self) -> T:
        """Return the next item."""
        if not self._remaining:
            self._remaining = [self._items[k] for k in self._rng.permutation(len(self._items))]
        return self._remaining.pop()
