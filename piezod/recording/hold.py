"""How a command runs between two samples, and when its reading is taken.

    straight       the command runs straight from sample to sample
    held           it keeps its value for one sample; the reading comes `read_after` of a sample after it
    held_before    it keeps its value for one sample; the reading comes just before the next command

The type stands here because the metadata of a recording is the lowest place that states it. Effects, model, diagnosis
and recorder use this type. Compiled functions cannot take it: they take `number`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

READ_AT_ONCE = 1e-6  # [samples]; smallest number that compiled functions take for a held command


@dataclass(frozen=True)
class Hold:
    """How a command runs between two samples.

    Parameters
    ----------
    sampling
        "straight": the command runs straight between samples. "held": it is held, and its reading is taken
        `read_after` later. "held_before": it is held, and its reading is taken just before it begins.
    read_after
        Time from the command to its reading [samples], 0 to 1. It is 0 unless `sampling` is "held".
    """

    sampling: Literal["straight", "held", "held_before"] = "straight"
    read_after: float = 0.0

    def __post_init__(self) -> None:
        assert 0.0 <= self.read_after <= (1.0 if self.sampling == "held" else 0.0)

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> "Hold | None":
        """Hold that a recording states as `sampling: held` and `read_after: X`, X above 0 to 1; None without these."""
        if metadata.get("sampling") != "held":
            return None
        try:
            read_after = float(metadata.get("read_after", ""))
        except ValueError:
            return None
        return cls("held", read_after) if 0.0 < read_after <= 1.0 else None

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata of a recording with this hold; empty unless it is held, because other holds are not recorded."""
        return {"sampling": "held", "read_after": f"{self.read_after:g}"} if self.sampling == "held" else {}

    @property
    def number(self) -> float:
        """Code for compiled functions. 0: straight. Above 0 to 1: held, `read_after`. 2: held before."""
        if self.sampling == "held":
            return self.read_after or READ_AT_ONCE
        return 2.0 if self.sampling == "held_before" else 0.0

    @property
    def straight(self) -> bool:
        """Whether the command runs straight between samples."""
        return self.sampling == "straight"

    @property
    def until_next(self) -> float:
        """Time from the reading to the command of the next sample [samples]; 0.5, the mean, for a straight command."""
        return 0.5 if self.straight else 1.0 - self.read_after


STRAIGHT = Hold()
HELD_BEFORE = Hold("held_before")
HELD_ONE_SAMPLE = Hold("held", 1.0)
"""The command is held for one sample until its reading, as in the ring log of the control loop."""
