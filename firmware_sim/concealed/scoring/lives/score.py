"""Scores the diagnoses of a study of lives against its sealed truth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.scoring.lives.verdicts import LifeVerdict, StepVerdict, read_life
from firmware_sim.concealed.scoring.verdicts import FINDINGS, sealed_at
from firmware_sim.concealed.study.life_truth import CHANGED_STEP, TrueLife, read_lives
from firmware_sim.concealed.study.seal import sealed_arrays, unpack_arrays


@dataclass(frozen=True)
class StepScore:
    """One step compared with the truth.

    Parameters
    ----------
    number
        1 to 4.
    expected
        True differences, each as `name:status`.
    right
        Unchanged step: no difference is reported, and the verdict is `matches`, or flags a remainder as the step before
        did.
        Other step: exactly `expected` is reported.
    """

    number: int
    expected: frozenset[str]
    verdict: StepVerdict
    right: bool


@dataclass(frozen=True)
class LifeScore:
    """One life compared with the truth.

    Parameters
    ----------
    steps
        Its four steps of work; empty: the diagnosis failed.
    inside
        For each end of a changed parameter (`from`, `to`), whether its interval holds the true value.
    errors
        Rms error of each model on the held-out record with the noise of the readings [noise rms], the identified model
        first. The bench is that before the change for the models of steps 0 to 2.
    """

    life: TrueLife
    steps: tuple[StepScore, ...]
    inside: tuple[bool, ...]
    errors: tuple[float, ...]

    def is_changed(self, step: StepScore) -> bool:
        """Whether the bench changed before this step of work."""
        return step.number == CHANGED_STEP and self.life.change != "none"

    def is_unchanged(self, step: StepScore) -> bool:
        """Whether the bench is as it was in the step before."""
        return step.number > 1 and not self.is_changed(step)


def score_lives(directory: Path, verdicts: Path, *, partial: bool = False) -> list[LifeScore]:
    """Score every life of a study.

    Parameters
    ----------
    directory
        Directory of the study.
    verdicts
        Directory with one folder per life.
    partial
        True: leave out lives without a verdict. False: refuse them.

    Raises
    ------
    StudyError
        The truth was changed, or a verdict is missing or older than the seal.
    """
    sealed, scores = sealed_at(directory), []
    for life in read_lives(directory):
        folder = verdicts / life.name
        verdict = read_life(folder, sealed)
        if verdict is not None:
            true_N = unpack_arrays(sealed_arrays(directory, life.name).read_bytes())
            scores.append(score_life(life, verdict, true_N["before_N"], true_N["after_N"]))
        elif (folder / FINDINGS).is_file():
            scores.append(LifeScore(life, (), (), ()))
        elif not partial:
            raise StudyError(f"{folder}: has no verdict; diagnose the life, or leave it out with --partial")
    return scores


def score_life(life: TrueLife, verdict: LifeVerdict, before_N: Array, after_N: Array) -> LifeScore:
    """Score one life.

    Parameters
    ----------
    before_N, after_N
        True force of the held-out record before and after the change, shape (n,) [N].
    """
    steps = []
    for number, step in enumerate(verdict.steps, 1):
        expected = life.differences(number)
        right = step.differences == expected and step.verdict != "failed"
        if number > 1 and not expected:
            as_before = step.flagged and verdict.steps[number - 2].flagged
            right = right and (step.verdict == "matches" or as_before)
        steps.append(StepScore(number, expected, step, right))
    errors = [
        _error(simulated_N - (before_N if generation < CHANGED_STEP else after_N), life.noise_N)
        for generation, simulated_N in enumerate(verdict.simulated_N)
    ]
    return LifeScore(life, tuple(steps), _inside(life, verdict.steps[CHANGED_STEP - 1]), tuple(errors))


def _error(error_N: Array, noise_N: float) -> float:
    """Rms of an error without its mean, together with the noise of the readings [noise rms]."""
    return float(np.hypot(np.std(error_N), noise_N)) / noise_N


def _inside(life: TrueLife, step: StepVerdict) -> tuple[bool, ...]:
    """Whether the intervals of a change that was reported hold the true values."""
    if life.change == "gain" and "base.gain" in step.new:
        return (step.new["base.gain"].holds(life.gain),)
    key = f"{life.effect}.{life.scale}"
    if life.differences(CHANGED_STEP) & step.differences != {f"{life.effect}:changed"} or key not in step.old:
        return ()
    ends = ((step.old[key], life.hidden), (step.new[key], life.since))
    return tuple(interval.holds(effects[life.effect][life.scale]) for interval, effects in ends)
