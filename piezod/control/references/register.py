"""The reference that a PLC writes into a register of the device."""

from math import isfinite

from piezod.config.reference import RegisterReference
from piezod.config.reference_range import ReferenceRange
from piezod.control.references.counts import ValueResult
from piezod.control.references.live import LiveReference
from piezod.transport import Reading


class RegisterValue(LiveReference):
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
    """

    def __init__(self, reading: Reading, config: RegisterReference, allowed: ReferenceRange, *, counted: bool) -> None:
        super().__init__(config.stale_after_s, config.when_stale)
        self._reading = reading
        self._low_N, self._high_N = allowed.low_N, allowed.high_N
        self._counted = counted
        self._counter: int | None = None

    def idle(self, now_ns: int) -> None:
        """Take the value of the last reading where it is new."""
        reading = self._reading
        if self._counted:
            before, self._counter = self._counter, reading.reference_counter
            if self._counter == before:
                return
            if before is None:
                if not isfinite(reading.reference_N):  # nothing was read yet
                    self._counter = None
                return
        self._count(self._result(reading.reference_N), reading.reference_N, now_ns)

    def _result(self, value_N: float) -> ValueResult:
        if not isfinite(value_N):
            return ValueResult.MALFORMED
        return ValueResult.ACCEPTED if self._low_N <= value_N <= self._high_N else ValueResult.OUT_OF_RANGE
