"""The opened truth of a study of lives."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from firmware_sim.concealed.study.seal import SEAL, open_truth

SCHEMA = "firmware_sim.concealed.lives/1"
CHANGED_STEP = 3
STATUSES = {"grows": "changed", "shrinks": "changed", "gone": "gone", "new": "new"}
"""Status of the effect of a life after each change."""


@dataclass(frozen=True)
class TrueLife:
    """The truth of one life.

    Parameters
    ----------
    family, change, effect
        As in `lives.Life`.
    scale
        Parameter that a growing or shrinking effect changes; empty: the life has no effect that changes.
    hidden, since
        Parameters of every effect before and after the change, by name.
    gain
        Gain of the stack after the change, relative to the gain before [1].
    noise_N
        Rms of the noise [N].
    """

    name: str
    family: str
    change: str
    effect: str
    scale: str
    hidden: Mapping[str, Mapping[str, float]]
    since: Mapping[str, Mapping[str, float]]
    gain: float
    noise_N: float

    def differences(self, step: int) -> frozenset[str]:
        """Differences that a diagnosis of a step from 1 to 4 should report, each as `name:status`."""
        if step == 1:
            return frozenset(f"{name}:new" for name in self.hidden)
        if step != CHANGED_STEP or self.change == "none":
            return frozenset()
        status = STATUSES.get(self.change)
        return frozenset({"base:changed" if status is None else f"{self.effect}:{status}"})


def holds_lives(directory: Path) -> bool:
    """Whether the seal of a study states lives; False too where the seal cannot be read."""
    try:
        return "lives" in json.loads((directory / SEAL).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def read_lives(directory: Path) -> list[TrueLife]:
    """Read every life of a study, after a check of its seal.

    Raises
    ------
    SealError
        The sealed truth is missing or was changed.
    """
    lives: Any = open_truth(directory)["lives"]
    return [TrueLife(name, **fields) for name, fields in lives.items()]
