"""The rule by which a search takes one more effect, chosen by replay files with each family of plants left out.

    piezod blind run STUDY -o VERDICTS
    python -m tests.studies rules STUDY VERDICTS [STUDY VERDICTS ...]

A decision is one round of a search: every effect that was fitted beside those found so far. The rule takes the best of
those that are worth it. One that bends to nearly anything must gain steadily besides. Taking one that is not hidden is
false. Taking none where a hidden one was fitted misses it. Hum, vibration, dropouts and quantisation are found by other
means and do not count. Both constants of the rule are chosen on a grid by the decisions of three families, and tried on
the fourth.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from firmware_sim.concealed.study.truth import TrueCase, read_truth
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import (
    comparable,
    least_gain,
    penalised_loss,
    steadiness,
)
from piezod.effects import EFFECTS

BY_OTHER_MEANS = {"mains_hum", "vibration", "sensor_dropout", "quantisation"}
GRID = [(worth, steadily) for worth in (0.08, 0.1, 0.14, 0.18, 0.22, 0.28, 0.35, 0.5) for steadily in (2.5, 5.0, 10.0)]
COSTS = {"false": 1.0, "false in a null": 1.0, "false in a foreign case": 0.5, "missed": 2.0}
"""A false one may still be dropped later, and in a foreign case whatever is taken is false; what is missed is lost."""

LOST = 1e300  # loss of a block that a hypothesis cannot simulate
SAME_ROUND = 1e-4  # of the loss: candidates are written in the order of their losses, and a new round begins anew

Rule = tuple[float, float]


@dataclass(frozen=True)
class Candidate:
    """One effect beside those found: what it gains and what the rule knows of it.

    Parameters
    ----------
    name
        Effect.
    gain
        Of the loss that it leaves.
    steadiness
        Of its gains over the blocks.
    weighed
        Its loss with the price of its parameters.
    """

    name: str
    gain: float
    steadiness: float
    weighed: float


@dataclass(frozen=True)
class Decision:
    """One round of a search.

    Parameters
    ----------
    case
        The truth.
    left
        Hidden effects that were not found before.
    candidates
        Those that are what their names say.
    """

    case: TrueCase
    left: frozenset[str]
    candidates: tuple[Candidate, ...]

    def error(self, rule: Rule) -> str:
        """What a rule does wrong here; empty: nothing."""
        worth = [one for one in self.candidates if one.gain > least_gain(one.steadiness, *rule)]
        taken = [one for one in worth if not EFFECTS[one.name].flexible or one.steadiness > RULES.steady]
        if taken:
            right = min(taken, key=lambda one: one.weighed).name in self.left
            kinds = {"null": "false in a null", "foreign": "false in a foreign case"}
            return "" if right else kinds.get(self.case.kind, "false")
        return "missed" if any(one.name in self.left for one in self.candidates) else ""


def decisions(study: Path, verdicts: Path) -> Iterator[Decision]:
    """All rounds of the cases that have a replay file."""
    for case in read_truth(study):
        path = verdicts / case.name / "replay.json"
        if not path.exists():
            continue
        content = json.loads(path.read_text(encoding="utf-8"))
        fitted = [_fitted(one) for one in content["hypotheses"]]
        for attempts in _rounds(content["attempts"], fitted):
            found = set(fitted[attempts[0]["before"]].effects)
            candidates = [
                _candidate(fitted[one["before"]], fitted[one["after"]]) for one in attempts if not one["degenerate"]
            ]
            yield Decision(case, frozenset(case.names - found - BY_OTHER_MEANS), tuple(candidates))


def _rounds(attempts: Sequence[Mapping[str, Any]], fitted: Sequence[Fitted]) -> Iterator[list[Mapping[str, Any]]]:
    together: list[Mapping[str, Any]] = []
    for one in attempts:
        if one["stage"] != "one":
            continue
        if together:
            last, loss = together[-1], fitted[one["after"]].loss
            if one["round"] != last["round"] or loss < (1.0 - SAME_ROUND) * fitted[last["after"]].loss:
                yield together
                together = []
        together.append(one)
    if together:
        yield together


def _candidate(before: Fitted, after: Fitted) -> Candidate:
    name, price = after.effects[-1], penalised_loss(after)
    before, after = comparable(before, after)
    return Candidate(name, before.loss / after.loss - 1.0, steadiness(before, after), price)


def _fitted(one: Mapping[str, Any]) -> Fitted:
    choices = one.get("choices", [{} for _ in one["effects"]])  # files of November 2026 have none
    terms = tuple(
        Term(EFFECTS[name], scope, -1, tuple(chosen.items()))
        for name, scope, chosen in zip(one["effects"], one["scopes"], choices, strict=True)
    )
    point = Point(np.zeros(0), np.zeros(0), np.zeros(0), tuple(one["values"]))
    losses, in_fit, samples = (
        np.array([LOST if value is None else value for value in one[key]]) for key in ("losses", "in_fit", "samples")
    )
    return Fitted(terms, point, losses, in_fit, samples, tuple(one["spread"]))


def counted(rounds: Sequence[Decision], rule: Rule) -> Counter[str]:
    """Errors of a rule by kind."""
    return Counter(error for one in rounds if (error := one.error(rule)))


def _cost(errors: Mapping[str, int]) -> float:
    return sum(COSTS[name] * number for name, number in errors.items())


def table(rounds: Sequence[Decision]) -> str:
    """Errors of the rule as it is, and as three families choose it, on each family and on all."""
    header = f"{'':<14}{'rule':<16}{'decisions':>10}" + "".join(f"{name:>25}" for name in COSTS)
    lines = [header]
    present = (RULES.worth, RULES.steadily)

    def line(label: str, rule: str, number: int, errors: Mapping[str, int]) -> str:
        return f"{label:<14}{rule:<16}{number:>10}" + "".join(f"{errors.get(name, 0):>25}" for name in COSTS)

    chosen: Counter[str] = Counter()
    for family in sorted({one.case.family for one in rounds}):
        mine = [one for one in rounds if one.case.family == family]
        others = [one for one in rounds if one.case.family != family]
        best = min(GRID, key=lambda rule: _cost(counted(others, rule)))
        errors = counted(mine, best)
        chosen.update(errors)
        lines.append(line(family, f"{best[0]:g}, {best[1]:g}", len(mine), errors))
    lines.append(line("left out, all", "", len(rounds), chosen))
    lines.append(line("as it is, all", f"{present[0]:g}, {present[1]:g}", len(rounds), counted(rounds, present)))
    return "\n".join(lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="each study, followed by its verdicts")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    if len(options.folders) % 2:
        parser.error("a study without verdicts: give each study, followed by its verdicts")
    pairs = zip(options.folders[::2], options.folders[1::2], strict=True)
    rounds = [one for study, verdicts in pairs for one in decisions(study, verdicts)]
    print(table(rounds))
