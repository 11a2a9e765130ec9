"""Rounds that alternate the compared actions, so that load of the machine affects all of them."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

ROUNDS = 5
PERCENTILES = (50, 99)

Figures = Any  # a number, or an array of numbers


def alternate(actions: Mapping[str, Callable[[], Figures]], rounds: int = ROUNDS) -> dict[str, Figures]:
    """Median over the rounds of what each action returns; every round runs all of them in turn.

    Parameters
    ----------
    actions
        Each measures once and returns its figure, or several as an array.
    rounds
        How often.
    """
    found: dict[str, list[Figures]] = {name: [] for name in actions}
    for _ in range(rounds):
        for name, action in actions.items():
            found[name].append(action())
    return {name: np.median(figures, axis=0) for name, figures in found.items()}


def percentiles(values: Any) -> Figures:
    """`PERCENTILES` of one round."""
    return np.percentile(values, PERCENTILES)
