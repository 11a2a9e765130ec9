"""Makes a study of lives: draws the benches, writes their recordings, and seals the truth.

Each life is a case of the study. Its change and its family run through all combinations of both.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from firmware_sim.concealed.plant.record_context import Effect
from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.families import FAMILIES
from firmware_sim.concealed.study.life_truth import SCHEMA
from firmware_sim.concealed.study.lives import CHANGES, Life, draw_life
from firmware_sim.concealed.study.make import Progress, write_record, write_study
from firmware_sim.concealed.study.seal import pack_arrays, sealed_arrays

LIFE_SCHEMA = "firmware_sim.concealed.life/1"


def make_lives(
    directory: Path,
    lives: int,
    *,
    seed: int | None = None,
    families: Sequence[str] = tuple(FAMILIES),
    jobs: int = 1,
    progress: Progress | None = None,
) -> None:
    """Make a study of lives in a directory without a study.

    Parameters
    ----------
    directory
        Directory of the study; created if missing.
    seed
        Seed of the study; None draws one from the operating system.
    families
        Families of the plants, in turn.

    Raises
    ------
    StudyError
        The directory has a study already.
    """
    entropy = np.random.SeedSequence(seed)
    of_each = [families[k % len(families)] for k in range(lives)]
    changes = [CHANGES[k % len(CHANGES)] for k in range(lives)]  # 7 changes, 4 families: every pair in 28 lives
    write_study(
        directory, "lives", SCHEMA, entropy, make_life, (of_each, changes, entropy.spawn(lives)), jobs, progress
    )


def make_life(directory: Path, name: str, family: str, change: str, seed: np.random.SeedSequence) -> dict[str, object]:
    """Draw and write one life; return its truth.

    Parameters
    ----------
    directory
        Folder of the study.
    name
        Name of the life and of its folder.
    family, change, seed
        See `lives.draw_life`.

    Raises
    ------
    StudyError
        No attempt gave a change that shows.
    """
    life = draw_life(family, change, seed)
    folder = directory / name
    folder.mkdir(exist_ok=True)
    first, last = life.steps[0].case, life.steps[-1].case
    for step in life.steps:
        write_record(folder / step.record.name, step.case, step.record)
    write_record(folder / life.held_out.name, last, life.held_out)
    described = json.dumps(_description(life), indent=1) + "\n"
    (folder / "case.json").write_text(described, encoding="utf-8")
    true_N = {"before_N": first.repeatable_N(life.held_out), "after_N": last.repeatable_N(life.held_out)}
    sealed_arrays(directory, name).write_bytes(pack_arrays(true_N))
    return _truth(life)


def _description(life: Life) -> dict[str, object]:
    """Content of `case.json`, which the diagnosis may read."""
    names = [step.record.name for step in life.steps]
    return {
        "schema": LIFE_SCHEMA,
        "identification": names[0],
        "recordings": names[1:],
        "held_out": life.held_out.name,
        "input": "voltage_V",
        "output": "force_N",
        "start": "every record starts at rest, depoled, at 0 V; the recordings are in order of time",
    }


def _truth(life: Life) -> dict[str, object]:
    before, after = life.steps[0].case, life.steps[-1].case
    return {
        "family": life.family,
        "change": life.change,
        "effect": life.effect,
        "scale": ENTRIES[life.effect].scale if life.effect else "",
        "hidden": _parameters(life.hidden),
        "since": _parameters(life.since),
        "gain": after.plant.law.full_N / before.plant.law.full_N,
        "noise_N": before.noise.rms_N,
    }


def _parameters(effects: Mapping[str, Effect]) -> dict[str, dict[str, float]]:
    return {name: dict(on.parameters) for name, on in effects.items()}
