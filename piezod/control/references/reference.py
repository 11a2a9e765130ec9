"""The reference of the control loop: what every source of the force offers to a tick."""

from enum import IntEnum
from typing import Protocol


class Freshness(IntEnum):
    """Whether a reference can be followed."""

    LIVE = 0
    STALE = 1
    ENDED = 2


class Reference(Protocol):
    """Source of the force to follow.

    Attributes
    ----------
    freshness
        State after the last `read`.
    ramp_down_on_lapse
        True: ramp down when the reference ends or gets stale. False: hold the voltage.
    ahead
        Value to plan for after the last `read` [N]. It leads the value itself by delay and resonance of the bench where
        the reference is known ahead; otherwise both are equal.
    """

    freshness: Freshness
    ramp_down_on_lapse: bool
    ahead: float

    def begin(self) -> None:
        """Prepare for arming: nothing that waits to be received counts as new."""
        ...

    def idle(self, now_ns: int) -> None:
        """Take note of a tick that does not follow the reference; called instead of `read`.

        Parameters
        ----------
        now_ns
            Monotonic time at its begin [ns].
        """
        ...

    def start(self, tick: int) -> None:
        """Let the first sample belong to `tick`."""
        ...

    def read(self, tick: int, now_ns: int) -> float:
        """Newest value [N]; sets `freshness` and `ahead`.

        Parameters
        ----------
        now_ns
            Monotonic time at its begin [ns].
        """
        ...

    def close(self) -> None:
        """Release sockets and files."""
        ...
