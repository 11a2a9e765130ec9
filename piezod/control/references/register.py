"""The reference that a PLC writes into a register of the device."""

from math import isfinite

from piezod.config.reference import RegisterReference
from piezod.config.reference_range import ReferenceRange
from piezod.control.references.counts import ValueResult, new_counts
from piezod.control.references.reference import Freshness
from piezod.transport import Reading


class RegisterValue:
    """The register `reference`, which every exchange reads together with the force.

    Its age counts from the last change of `reference_counter` that was seen, also at rest. The value that the register
    has at the first reading may be of any age, so it is stale until the counter changes.

    Parameters
    ----------
    reading
        Reading of the link; every good exchange overwrites it in place.
    config
        Section `reference` of the bench configuration.
    allowed
        Range of the reference; a value beyond it is refused and counted.
    counted
        Whether the device has `reference_counter`. An unchanged counter makes the reference stale.

    Attributes
    ----------
    counts
        Number of values by `ValueResult`.
    """

    def __init__(self, reading: Reading, config: RegisterReference, allowed: ReferenceRange, *, counted: bool) -> None:
        self._reading = reading
        self._low_N, self._high_N = allowed.low_N, allowed.high_N
        self._stale_ns = round(config.stale_after_s * 1e9)
        self._counted = counted
        self._counter: int | None = None
        self._received_ns: int | None = None
        self.ahead = 0.0
        self.counts = new_counts()
        self.ramp_down_on_lapse = config.when_stale == "ramp_down"
        self.freshness = Freshness.STALE

    def begin(self) -> None:
        """No effect: the age of the value goes on counting."""

    def start(self, tick: int) -> None:
        """No effect: a value counts from the change of its counter."""

    def idle(self, now_ns: int) -> None:
        """Note a new value in a tick that does not follow it."""
        reading = self._reading
        if self._counted:
            before, self._counter = self._counter, reading.reference_counter
            if self._counter == before:
                return
            if before is None:
                if not isfinite(reading.reference_N):  # nothing was read yet
                    self._counter = None
                return
        self._accept(reading.reference_N, now_ns)

    def _accept(self, value_N: float, now_ns: int) -> None:
        if not isfinite(value_N):
            self.counts[ValueResult.MALFORMED] += 1
        elif not self._low_N <= value_N <= self._high_N:
            self.counts[ValueResult.OUT_OF_RANGE] += 1
        else:
            self.counts[ValueResult.ACCEPTED] += 1
            self.ahead, self._received_ns = value_N, now_ns

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Value of the last good reading [N]."""
        self.idle(now_ns)
        received = self._received_ns
        live = received is not None and now_ns - received < self._stale_ns
        self.freshness = Freshness.LIVE if live else Freshness.STALE
        return self.ahead

    def close(self) -> None:
        """No effect: the link is not this object's."""
