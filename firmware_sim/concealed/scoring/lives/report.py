"""Result of a study of lives as text and as JSON: figures, families and changes, and every wrong step.

Steps that a figure counts:

- unchanged: the bench is as it was in the step before;
- changed: step 3 of all lives but those without a change;
- first work: step 1, whose effects the identified model lacks;
- error after an unchanged step: error of its model on the held-out record, over the error of the model before;
- after five generations: the last model over the model of the first work, in lives without a change.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict

import numpy as np

from firmware_sim.concealed.scoring.figures import Figure, wilson
from firmware_sim.concealed.scoring.lives.score import LifeScore, StepScore
from firmware_sim.concealed.scoring.report import figure_table, table

FIRST, LAST = 1, 4  # generations whose models are compared in lives without a change


def lives_as_text(scores: Sequence[LifeScore]) -> str:
    """Result for a terminal."""
    wrong = failures(scores)
    parts = [
        figure_table(figures(scores)),
        table(_HEAD, _rows(scores, "family", lambda score: score.life.family)),
        table(_HEAD, _rows(scores, "change", lambda score: score.life.change)),
        "\n".join([f"{len(wrong)} wrong steps in {len(scores)} lives", *wrong]),
    ]
    return "\n\n".join(parts) + "\n"


def lives_as_json(scores: Sequence[LifeScore]) -> dict[str, object]:
    """Content of `lives_as_text`, and the numbers of every life."""
    return {
        "schema": "firmware_sim.concealed.lives_score/1",
        "figures": [asdict(figure) | {"reached": figure.reached} for figure in figures(scores)],
        "failures": failures(scores),
        "lives": {score.life.name: _life(score) for score in scores},
    }


def figures(scores: Sequence[LifeScore]) -> list[Figure]:
    """All figures, in the order of the table."""
    unchanged = [step for score in scores for step in score.steps if score.is_unchanged(step)]
    all_steps = [step.verdict for score in scores for step in score.steps]
    changed = [score for score in scores if score.life.change != "none"]
    differ = [abs(step.before / step.simulated - 1.0) for step in all_steps if step.verdict != "failed"]
    still = [score for score in scores if score.life.change == "none" and score.steps]
    ratios = [_ratio(score, step) for score in scores for step in score.steps if score.is_unchanged(step)]
    return [
        _share("unchanged steps: matches, nothing reported", _rights(scores, LifeScore.is_unchanged), 0.93, 0.98),
        _share("changed steps: the right thing and status", [_is_right(score, 3) for score in changed], 0.80, 0.92),
        _share("first work: exactly the hidden effects", [_is_right(score, 1) for score in scores], 0.80, 0.92),
        _share("from and to inside their intervals", [inside for s in scores for inside in s.inside], 0.88, 0.94),
        _number(
            "given effects reported as new",
            float(sum(len(s.reported_as_new) for s in all_steps)),
            len(all_steps),
            0.0,
            0.0,
        ),
        _number("before beside simulate, largest difference", _largest(differ), len(differ), 0.01, 1e-6, percent=True),
        _number("error after an unchanged step, median", _quantile(ratios, 0.5), len(ratios), 1.02, 1.0),
        _number("error after an unchanged step, 95th percentile", _quantile(ratios, 0.95), len(ratios), 1.02, 1.0),
        _number("error after five generations, largest", _largest(_errors(still)), len(still), 1.02, 1.0),
        _share("the same number of effects after five generations", [_same_effects(s) for s in still], 1.0, 1.0),
        _number("size of the file after five generations, largest", _largest(_sizes(still)), len(still), 1.02, 1.0),
        _number(
            "processor time of an unchanged step, median [s]",
            _quantile([step.verdict.cpu_s for step in unchanged], 0.5),
            len(unchanged),
            5.0,
            2.0,
        ),
    ]


def failures(scores: Sequence[LifeScore]) -> list[str]:
    """One line for each wrong step."""
    lines = []
    for score in scores:
        life = score.life
        head = f"{life.name} {life.family}, {' + '.join(life.hidden)}, {life.change} {life.effect}".rstrip()
        if not score.steps:
            lines.append(f"{head}: failed")
        for step in score.steps:
            if not step.right:
                expected, reported = (
                    ", ".join(sorted(names)) or "nothing" for names in (step.expected, step.verdict.differences)
                )
                lines.append(f"{head}: step {step.number}: {expected} -> {step.verdict.verdict} [{reported}]")
    return lines


def _rights(scores: Iterable[LifeScore], counts: Callable[[LifeScore, StepScore], bool]) -> list[bool]:
    return [step.right for score in scores for step in score.steps if counts(score, step)]


def _is_right(score: LifeScore, number: int) -> bool:
    """Whether a step is right; a failed life is wrong."""
    return bool(score.steps) and score.steps[number - 1].right


def _ratio(score: LifeScore, step: StepScore) -> float:
    return score.errors[step.number] / score.errors[step.number - 1]


def _errors(still: Iterable[LifeScore]) -> list[float]:
    return [score.errors[LAST] / score.errors[FIRST] for score in still]


def _sizes(still: Iterable[LifeScore]) -> list[float]:
    return [score.steps[-1].verdict.model_bytes / score.steps[0].verdict.model_bytes for score in still]


def _same_effects(score: LifeScore) -> bool:
    return score.steps[-1].verdict.effects == score.steps[0].verdict.effects


def _share(name: str, hits: Sequence[bool], least: float, aim: float) -> Figure:
    if not hits:
        return Figure(name, None, 0, least, aim)
    return Figure(name, sum(hits) / len(hits), len(hits), least, aim, interval=wilson(sum(hits), len(hits)))


def _number(name: str, value: float | None, count: int, least: float, aim: float, *, percent: bool = False) -> Figure:
    return Figure(name, value if count else None, count, least, aim, rising=False, percent=percent)


def _largest(values: Sequence[float]) -> float | None:
    return max(values, default=None)


def _quantile(values: Sequence[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


_HEAD = ["", "lives", "first work right", "unchanged right", "changed right", "given as new", "processor s a life"]


def _rows(scores: Sequence[LifeScore], kind: str, key: Callable[[LifeScore], str]) -> list[list[str]]:
    """Counts of each family, or of each change."""
    rows = []
    for name in sorted({key(score) for score in scores}):
        members = [score for score in scores if key(score) == name]
        unchanged, changed = (_rights(members, of) for of in (LifeScore.is_unchanged, LifeScore.is_changed))
        steps = [step.verdict for score in members for step in score.steps]
        rows.append(
            [
                f"{kind} {name}",
                str(len(members)),
                str(sum(_is_right(score, 1) for score in members)),
                f"{sum(unchanged)} of {len(unchanged)}",
                f"{sum(changed)} of {len(changed)}",
                str(sum(len(step.reported_as_new) for step in steps)),
                f"{sum(step.cpu_s for step in steps) / len(members):.0f}",
            ]
        )
    return rows


def _life(score: LifeScore) -> dict[str, object]:
    life = score.life
    return {
        "family": life.family,
        "change": life.change,
        "effect": life.effect,
        "hidden": sorted(life.hidden),
        "inside": list(score.inside),
        "errors": list(score.errors),
        "steps": [
            {
                "expected": sorted(step.expected),
                "reported": sorted(step.verdict.differences),
                "verdict": step.verdict.verdict,
                "right": step.right,
                "reported_as_new": sorted(step.verdict.reported_as_new),
                "before": step.verdict.before,
                "simulated": step.verdict.simulated,
                "cpu_s": step.verdict.cpu_s,
            }
            for step in score.steps
        ],
    }
