"""The replay file: every hypothesis that a search tried, with what a rule of acceptance needs, without the recordings.

A rule can be tried on the replay files of hundreds of diagnoses in seconds.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.chain import Setting
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.errors import ConfigurationError

Array = NDArray[np.float64]

SCHEMA = "piezod.replay/1"
DIGITS = 5


@dataclass(frozen=True)
class Attempt:
    """A hypothesis beside the one that it extends.

    Parameters
    ----------
    stage
        `one` more effect, `pair` of effects at once, or `drop`: an effect of the final hypothesis left out.
    round
        Number of effects that were accepted before.
    before, after
        Hypothesis without and with the effect.
    degenerate
        Whether the effect is not what its name says.
    believed
        Whether the rules of acceptance took it for an effect.
    """

    stage: str
    round: int
    before: Fitted
    after: Fitted
    degenerate: bool
    believed: bool


def fitted_in(tried: Sequence[Fitted], places: Sequence[tuple[str, str]]) -> dict[str, Setting]:
    """Parameters and choices of effects, as the best of the fullest hypotheses has them.

    Parameters
    ----------
    tried
        Hypotheses.
    places
        Names, each with the name of the effect that it replaces; empty: none.
    """
    names = {name for name, instead_of in places if not instead_of}
    result: dict[str, Setting] = {}
    for name, instead_of in places:
        options = [
            (one, k)
            for one in tried
            for k, term in enumerate(one.terms)
            if term.effect.name == name and set(one.effects) - {name} <= names - {instead_of}
        ]
        if options and name not in result:
            best, k = max(options, key=lambda option: (len(option[0].terms), -option[0].loss))
            result[name] = dict(best.point.values[k]), best.terms[k].choices
    return result


def write_replay(path: Path, attempts: Sequence[Attempt]) -> None:
    """Write a replay file.

    Parameters
    ----------
    path
        JSON file. `hypotheses` holds every hypothesis once, and `attempts` refers to them by number. Each has names,
        scopes, parameters, and their standard errors on the scale that is searched. For every block it has the number
        of samples and the mean square residual, in units of the noise squared. `losses` are those of blocks left out
        of the fit, `in_fit` those of blocks within it.
    attempts
        In the order of the search.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    numbers: dict[int, int] = {}
    hypotheses: list[dict[str, Any]] = []

    def number(one: Fitted) -> int:
        if id(one) not in numbers:
            numbers[id(one)] = len(hypotheses)
            hypotheses.append(_hypothesis(one))
        return numbers[id(one)]

    content = {
        "schema": SCHEMA,
        "attempts": [
            {
                "stage": one.stage,
                "round": one.round,
                "before": number(one.before),
                "after": number(one.after),
                "degenerate": one.degenerate,
                "believed": one.believed,
            }
            for one in attempts
        ],
        "hypotheses": hypotheses,
    }
    try:
        path.write_text(json.dumps(content) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error


def _hypothesis(one: Fitted) -> dict[str, Any]:
    return {
        "effects": [term.effect.name for term in one.terms],
        "scopes": [term.scope for term in one.terms],
        "choices": [dict(term.choices) for term in one.terms],
        "values": [{name: _short(value) for name, value in values.items()} for values in one.point.values],
        "spread": [{name: _short(value) for name, value in values.items()} for values in one.spread],
        "losses": [_short(value) for value in one.losses],
        "in_fit": [_short(value) for value in one.in_fit],
        "samples": [_short(value) for value in one.samples],
    }


def _short(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
