"""What a reference from a register and one from datagrams have in common: values that arrive, and their age."""

from typing import Literal

from piezod.control.references.counts import ValueResult, new_counts
from piezod.control.references.reference import Freshness


class LiveReference:
    """Newest accepted value, live until it is `stale_after_s` old.

    Parameters
    ----------
    stale_after_s
        Largest age of a live value [s].
    when_stale
        Key `reference.when_stale` of the bench configuration.

    Attributes
    ----------
    counts
        Number of values by `ValueResult`.
    """

    def __init__(self, stale_after_s: float, when_stale: Literal["hold", "ramp_down"]) -> None:
        self._stale_ns = round(stale_after_s * 1e9)
        self._received_ns: int | None = None
        self.ahead = 0.0
        self.counts = new_counts()
        self.ramp_down_on_lapse = when_stale == "ramp_down"
        self.freshness = Freshness.STALE

    def begin(self) -> None:
        """No effect: the age of the value goes on counting."""

    def start(self, tick: int) -> None:
        """No effect: the age of a value counts from its arrival."""

    def idle(self, now_ns: int) -> None:
        """Take the values that have arrived.

        Parameters
        ----------
        now_ns
            Monotonic time at the begin of the tick [ns].
        """
        raise NotImplementedError

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Newest accepted value [N]."""
        self.idle(now_ns)
        received = self._received_ns
        live = received is not None and now_ns - received < self._stale_ns
        self.freshness = Freshness.LIVE if live else Freshness.STALE
        return self.ahead

    def close(self) -> None:
        """No effect where nothing was opened."""

    def _count(self, result: ValueResult, value_N: float, now_ns: int) -> None:
        """Count a value [N], and take it when it was accepted."""
        self.counts[result] += 1
        if result is ValueResult.ACCEPTED:
            self.ahead, self._received_ns = value_N, now_ns
