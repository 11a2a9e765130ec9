"""The result of one check."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["OK", "WARN", "FAIL"]


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Parameters
    ----------
    level
        `OK`, `WARN`: the bench can run, or `FAIL`: the bench cannot run.
    found
        Result in words.
    remedy
        Remedy; empty without a fault.
    """

    name: str
    level: Level
    found: str
    remedy: str = ""
