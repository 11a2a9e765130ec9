"""Replay file: every hypothesis that a search compared, with the losses that a rule of acceptance needs.

A rule can be tested on the replay files of hundreds of diagnoses in seconds, without the recordings.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.terms import Setting
from piezod.runtime.files import written

SCHEMA = "piezod.replay/1"
DIGITS = 5  # significant digits in the file


@dataclass(frozen=True)
class Attempt:
    """Comparison of a hypothesis with its extension by an effect.

    Parameters
    ----------
    stage
        `one` more effect, a `pair` of effects, or `drop`: an effect of the final hypothesis is removed.
    round
        Number of effects accepted before.
    before, after
        Hypothesis without and with the effect.
    degenerate
        Whether the parameters of the effect are implausible.
    accepted
        Whether the rules of acceptance accept the effect.
    """

    stage: str
    round: int
    before: Fitted
    after: Fitted
    degenerate: bool
    accepted: bool


def fitted_in(tried: Sequence[Fitted], places: Sequence[tuple[str, str]]) -> dict[str, Setting]:
    """Parameters and choices of effects in the best of the hypotheses with the most effects.

    `places`: names of effects, each with the name of the effect that it replaces (empty: none).
    """
    names = {name for name, replaced in places if not replaced}
    result: dict[str, Setting] = {}
    for name, replaced in places:
        options = [
            (hypothesis, k)
            for hypothesis in tried
            for k, term in enumerate(hypothesis.terms)
            if term.effect.name == name and set(hypothesis.effects) - {name} <= names - {replaced}
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
        scopes, parameters, and their standard errors on the search scale. For every block it has the number of samples
        and the mean square residual [noise variance]: `losses` without the block in the fit, `in_fit` with it.
    attempts
        Comparisons in the order of the search.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    numbers: dict[int, int] = {}
    hypotheses: list[dict[str, Any]] = []

    def number(hypothesis: Fitted) -> int:
        if id(hypothesis) not in numbers:
            numbers[id(hypothesis)] = len(hypotheses)
            hypotheses.append(_entry(hypothesis))
        return numbers[id(hypothesis)]

    content = {
        "schema": SCHEMA,
        "attempts": [
            {
                "stage": attempt.stage,
                "round": attempt.round,
                "before": number(attempt.before),
                "after": number(attempt.after),
                "degenerate": attempt.degenerate,
                "believed": attempt.accepted,
            }
            for attempt in attempts
        ],
        "hypotheses": hypotheses,
    }
    written(path, json.dumps(content) + "\n")


def _entry(fitted: Fitted) -> dict[str, Any]:
    return {
        "effects": [term.effect.name for term in fitted.terms],
        "scopes": [term.scope for term in fitted.terms],
        "choices": [dict(term.choices) for term in fitted.terms],
        "values": [{name: _short(value) for name, value in values.items()} for values in fitted.point.values],
        "spread": [{name: _short(value) for name, value in values.items()} for values in fitted.spread],
        "losses": [_short(value) for value in fitted.losses],
        "in_fit": [_short(value) for value in fitted.in_fit],
        "samples": [_short(value) for value in fitted.samples],
    }


def _short(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
