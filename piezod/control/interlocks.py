"""Interlocks: each checks one quantity of every good reading and returns the cause of a trip, or `Cause.NONE`.

The supervisor calls `clear` when the bench is armed, and `check` with every good reading while voltages are written.
`set_limits` replaces the limits and keeps everything else: a new limit discards no heat, count or time.
The states are plain floats and integers, so a check allocates no container.
"""

from math import inf, isfinite, nan

from piezod.config import LimitsConfig
from piezod.control.states import Cause


class ForceInterlock:
    """Force above or below its limits, or changed faster than its rate limit.

    It trips after `limits.force_debounce_samples` wrong samples in a row. A sample exceeds the rate limit when it
    differs too much from the last right sample, for the time since then. A spike ends with the next sample; a lasting
    jump stays wrong.

    Parameters
    ----------
    limits
        Force limits and debounce.

    Attributes
    ----------
    suspect
        True after a wrong sample, until the next sample decides. The voltage must not rise meanwhile.
    spikes
        Number of wrong samples that the next sample did not confirm.
    """

    __slots__ = (
        "_force_N",
        "_in_a_row",
        "_max_N",
        "_min_N",
        "_needed",
        "_rate_N_per_ns",
        "_time_ns",
        "spikes",
        "suspect",
    )

    def __init__(self, limits: LimitsConfig) -> None:
        self.spikes = 0
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the earlier samples and the debounce stay."""
        self._max_N, self._min_N = limits.force_trip_N, limits.force_min_N
        self._rate_N_per_ns = inf if limits.force_rate_trip_N_per_s is None else 1e-9 * limits.force_rate_trip_N_per_s
        self._needed = limits.force_debounce_samples

    def clear(self) -> None:
        """Discard the earlier samples."""
        self._force_N, self._time_ns = nan, 0
        self._in_a_row = 0
        self.suspect = False

    def check(self, force_N: float, now_ns: int) -> Cause:
        """Cause of a trip; `Cause.NONE` inside the limits and during the debounce.

        Parameters
        ----------
        force_N
            Force read [N].
        now_ns
            Monotonic time of the reading [ns].
        """
        cause = Cause.NONE
        if force_N > self._max_N:
            cause = Cause.OVER_FORCE
        elif force_N < self._min_N:
            cause = Cause.UNDER_FORCE
        elif abs(force_N - self._force_N) > self._rate_N_per_ns * (now_ns - self._time_ns):  # False for nan
            cause = Cause.FORCE_RATE
        if cause is Cause.NONE:
            self.spikes += self.suspect
            self._force_N, self._time_ns, self._in_a_row = force_N, now_ns, 0
            self.suspect = False
            return cause
        self._in_a_row += 1
        self.suspect = True
        return cause if self._in_a_row >= self._needed else Cause.NONE


class StuckInterlock:
    """Equal force readings in a row while the voltage moves.

    Parameters
    ----------
    limits
        Number of equal readings, and the travel of the voltage [V].
    """

    __slots__ = ("_equal", "_force_N", "_heartbeat", "_high_V", "_low_V", "_samples", "_travel_V")

    def __init__(self, limits: LimitsConfig) -> None:
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the count of equal samples and their travel stay."""
        self._samples = limits.stuck_samples or 0
        self._travel_V = limits.stuck_travel_V

    def clear(self) -> None:
        """Discard the earlier samples."""
        self._force_N, self._heartbeat, self._equal = nan, -1, 0
        self._low_V = self._high_V = 0.0

    def check(self, force_N: float, heartbeat: int, written_V: float) -> Cause:
        """Count equal samples; a different force starts the count again.

        Parameters
        ----------
        force_N
            Force read [N].
        heartbeat
            Sample counter of the device; an unchanged counter is the same sample. 0: the device has no counter.
        written_V
            Voltage in force [V].
        """
        if self._samples == 0:
            return Cause.NONE
        if force_N != self._force_N:
            self._force_N, self._equal = force_N, 1
            self._low_V = self._high_V = written_V
        elif heartbeat == 0 or heartbeat != self._heartbeat:
            self._equal += 1
        self._heartbeat = heartbeat
        self._low_V, self._high_V = min(self._low_V, written_V), max(self._high_V, written_V)
        stuck = self._equal >= self._samples and self._high_V - self._low_V >= self._travel_V
        return Cause.SENSOR_STUCK if stuck else Cause.NONE


class ReadbackInterlock:
    """Voltage readback outside the band of the voltages that were written recently.

    The amplifier needs time to follow. The band therefore covers the current window of `readback_trip_ms` and the
    window before it.

    Parameters
    ----------
    limits
        Margin of the band [V] and length of a window [ms].
    """

    __slots__ = ("_begun_ns", "_earlier_high", "_earlier_low", "_high", "_low", "_outside", "_trip_V", "_window_ns")

    def __init__(self, limits: LimitsConfig) -> None:
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the band of the voltages written and the count stay."""
        self._trip_V = inf if limits.readback_trip_V is None else limits.readback_trip_V
        self._window_ns = round(1e6 * limits.readback_trip_ms)

    def clear(self) -> None:
        """Discard the voltages written earlier."""
        self._low = self._earlier_low = inf
        self._high = self._earlier_high = -inf
        self._begun_ns = self._outside = 0

    def check(self, readback_V: float, written_V: float, now_ns: int) -> Cause:
        """Trip at the second sample in a row outside the band: a single sample can be a spike of the monitor.

        Parameters
        ----------
        readback_V
            Voltage read back [V]; nan where the device has none.
        written_V
            Voltage in force [V].
        now_ns
            Monotonic time of the reading [ns].
        """
        if now_ns - self._begun_ns > self._window_ns:
            self._earlier_low, self._earlier_high = self._low, self._high
            self._low = self._high = written_V
            self._begun_ns = now_ns
        self._low, self._high = min(self._low, written_V), max(self._high, written_V)
        low, high = min(self._low, self._earlier_low), max(self._high, self._earlier_high)
        inside = low - self._trip_V <= readback_V <= high + self._trip_V
        self._outside = 0 if inside or not isfinite(readback_V) else self._outside + 1
        return Cause.READBACK if self._outside > 1 else Cause.NONE


class TrackingInterlock:
    """Force far from its reference for a time, although the planned voltage was written unchanged.

    Parameters
    ----------
    limits
        Largest error [N] and its duration [ms].
    """

    __slots__ = ("_duration_ns", "_expected_N", "_since_ns", "_trip_N")

    def __init__(self, limits: LimitsConfig) -> None:
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the time since which the error lasts stays."""
        self._trip_N = inf if limits.tracking_trip_N is None else limits.tracking_trip_N
        self._duration_ns = round(1e6 * limits.tracking_trip_ms)

    def clear(self) -> None:
        """Discard the earlier error."""
        self._expected_N, self._since_ns = nan, -1

    def check(self, force_N: float, reference_N: float, now_ns: int) -> Cause:
        """Compare the force with the reference of the exchange before.

        Parameters
        ----------
        force_N
            Force read [N].
        reference_N
            Reference of this exchange [N]; nan where the voltage could not be written as planned.
        now_ns
            Monotonic time of the reading [ns].
        """
        expected_N, self._expected_N = self._expected_N, reference_N
        if not isfinite(expected_N):
            return Cause.NONE
        if abs(force_N - expected_N) <= self._trip_N:
            self._since_ns = -1
            return Cause.NONE
        if self._since_ns < 0:
            self._since_ns = now_ns
        return Cause.TRACKING if now_ns - self._since_ns >= self._duration_ns else Cause.NONE
