"""Interlocks: each checks one quantity of every good reading and returns the cause of a trip, or `Cause.NONE`.

The supervisor calls `clear` when the bench is armed, and `check` with every good reading while voltages are written.
`set_limits` replaces the limits and keeps everything else: a new limit discards no heat, count or time.
The states are plain floats and integers, so a check allocates no container.

A debounce counts with a leak; see `leaky_count.py`.
"""

from math import inf, isfinite, nan

from piezod.config import LimitsConfig
from piezod.control.leaky_count import WRONG, LeakyCount
from piezod.control.states import Cause
from piezod.transport.status import STATUS_CLAMPED, STATUS_OUTPUT_ON

STRANGE_SAMPLES = 10
"""Implausible temperatures in a row that trip: a temperature changes slowly, and a sample may be lost."""

SLOPE_SHARE = 0.01  # of the voltage range: way over which the slope of the force is measured

SECOND_SAMPLE = WRONG + 1
"""Level of a second wrong sample, unless so many right ones lie between that the first has leaked away."""


class ForceInterlock:
    """Force above or below its limits, or changed faster than its rate limit.

    It trips after `limits.force_debounce_samples` wrong samples, counted with a leak. A sample exceeds the rate limit
    when it differs too much from the last right sample, for the time since then. A spike ends with the next sample; a
    lasting jump stays wrong.

    A force limit counts the way that the output would still rise while it brakes, as force. The slope is that over the
    last `SLOPE_SHARE` of the voltage range.

    Attributes
    ----------
    suspect
        True after a wrong sample, until the next sample decides. The voltage must not rise meanwhile.
    spikes
        Number of wrong samples that the next sample did not confirm.
    count
        Leaky count of wrong samples.
    """

    def __init__(self, limits: LimitsConfig) -> None:
        self.spikes = 0
        self.count = LeakyCount()
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the earlier samples and the debounce stay."""
        self._max_N, self._min_N = limits.force_trip_N, limits.force_min_N
        self._way_V = SLOPE_SHARE * (limits.voltage_max_V - limits.voltage_min_V)
        self._rate_N_per_ns = inf if limits.force_rate_trip_N_per_s is None else 1e-9 * limits.force_rate_trip_N_per_s
        self.count.trips_at = WRONG * limits.force_debounce_samples

    def clear(self) -> None:
        """Discard the earlier samples."""
        self._force_N, self._time_ns = nan, 0
        self._from_V = self._from_N = self._slope_N_per_V = self._braking_N = 0.0
        self.count.clear()
        self.suspect = False

    def count_braking(self, force_N: float, written_V: float, braking_V: float) -> None:
        """Add the rise of the force while the output brakes to the next force that is checked.

        Parameters
        ----------
        force_N, written_V
            Force read [N], and voltage in force [V].
        braking_V
            `Limiter.braking_V` [V].
        """
        moved_V = written_V - self._from_V
        if abs(moved_V) >= self._way_V:
            self._slope_N_per_V = max(0.0, (force_N - self._from_N) / moved_V)
            self._from_V, self._from_N = written_V, force_N
        self._braking_N = self._slope_N_per_V * braking_V

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
        if force_N + self._braking_N > self._max_N:
            cause = Cause.OVER_FORCE
        elif force_N < self._min_N:
            cause = Cause.UNDER_FORCE
        elif abs(force_N - self._force_N) > self._rate_N_per_ns * (now_ns - self._time_ns):  # False for nan
            cause = Cause.FORCE_RATE
        if cause is Cause.NONE:
            self.spikes += self.suspect
            self._force_N, self._time_ns = force_N, now_ns
            if self.count.level:
                self.count.leak()
            self.suspect = False
            return cause
        self.suspect = True
        return cause if self.count.add() else Cause.NONE


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

    Attributes
    ----------
    count
        Leaky count of the samples outside the band; the second one trips.
    """

    __slots__ = ("_begun_ns", "_earlier_high", "_earlier_low", "_high", "_low", "_trip_V", "_window_ns", "count")

    def __init__(self, limits: LimitsConfig) -> None:
        self.count = LeakyCount(SECOND_SAMPLE)
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
        self._begun_ns = 0
        self.count.clear()

    def check(self, readback_V: float, written_V: float, now_ns: int) -> Cause:
        """Trip at the second sample outside the band, counted with a leak: a single one can be a spike of the monitor.

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
        if inside or not isfinite(readback_V):
            if self.count.level:
                self.count.leak()
            return Cause.NONE
        return Cause.READBACK if self.count.add() else Cause.NONE


class TrackingInterlock:
    """Force far from the expected force for a time.

    The time counts with a leak: time with a right force takes a third of itself away.

    Parameters
    ----------
    limits
        Largest error [N] and its duration [ms].

    Attributes
    ----------
    count
        Time with a wrong force [ns], with a leak.
    """

    __slots__ = ("_expected_N", "_last_ns", "_trip_N", "count")

    def __init__(self, limits: LimitsConfig) -> None:
        self.count = LeakyCount()
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the time for which the error has lasted stays."""
        self._trip_N = inf if limits.tracking_trip_N is None else limits.tracking_trip_N
        self.count.trips_at = round(1e6 * limits.tracking_trip_ms)

    def clear(self) -> None:
        """Discard the earlier error."""
        self._expected_N, self._last_ns = nan, 0
        self.count.clear()

    def check(self, force_N: float, expected_N: float, now_ns: int) -> Cause:
        """Compare the force with the one that was expected at the exchange before.

        Parameters
        ----------
        force_N
            Force read [N].
        expected_N
            Force that the voltage of this exchange should give [N]; nan where none is expected.
        now_ns
            Monotonic time of the reading [ns].
        """
        before_N, self._expected_N = self._expected_N, expected_N
        since_ns, self._last_ns = now_ns - self._last_ns, now_ns
        if not isfinite(before_N):
            return Cause.NONE
        if abs(force_N - before_N) <= self._trip_N:
            if self.count.level:
                self.count.leak(since_ns // WRONG)
            return Cause.NONE
        lasted_ns = self.count.level
        self.count.add(since_ns)
        return Cause.TRACKING if lasted_ns >= self.count.trips_at else Cause.NONE


class DeviceInterlock:
    """Output that the device reports as off, or as clamped for a time, although voltages are written.

    Parameters
    ----------
    limits
        Which bits of the status register the device has, and the longest time of a clamped output [ms].

    Attributes
    ----------
    count
        Leaky count of the samples with the output off; the second one trips.
    """

    __slots__ = ("_clamped_ns", "_has_output_bit", "_since_ns", "_was_on", "count")

    def __init__(self, limits: LimitsConfig) -> None:
        self.count = LeakyCount(SECOND_SAMPLE)
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the earlier samples stay."""
        self._has_output_bit = limits.output_on_in_status
        self._clamped_ns = inf if limits.clamped_trip_ms is None else 1e6 * limits.clamped_trip_ms

    def clear(self) -> None:
        """Discard the earlier samples; the output may be off until it was on once."""
        self._since_ns, self._was_on = -1, False
        self.count.clear()

    def check(self, status: int, now_ns: int) -> Cause:
        """Trip at the second sample with the output off, and after `clamped_trip_ms` with the output clamped.

        Parameters
        ----------
        status
            Status bits of the device.
        now_ns
            Monotonic time of the reading [ns].
        """
        if not status & STATUS_CLAMPED:
            self._since_ns = -1
        elif self._since_ns < 0:
            self._since_ns = now_ns
        elif now_ns - self._since_ns >= self._clamped_ns:
            return Cause.CLAMPED
        if not self._has_output_bit:
            return Cause.NONE
        if status & STATUS_OUTPUT_ON:
            self._was_on = True
            if self.count.level:
                self.count.leak()
        elif self._was_on:
            self.count.add()
        return Cause.OUTPUT_OFF if self.count.level >= SECOND_SAMPLE else Cause.NONE


class TemperatureInterlock:
    """Temperature above its limit, or one that no sensor of a bench gives: too low, missing, or the same for long.

    Parameters
    ----------
    limits
        Highest temperature [degC]; null: nothing is checked. Lowest plausible one [degC]; longest time without a
        change [s].

    Attributes
    ----------
    count
        Leaky count of implausible samples.
    """

    __slots__ = ("_frozen_ns", "_high_C", "_last_C", "_low_C", "_since_ns", "count")

    def __init__(self, limits: LimitsConfig) -> None:
        self.count = LeakyCount(WRONG * STRANGE_SAMPLES)
        self.clear()
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the earlier samples stay."""
        self._high_C = inf if limits.temperature_trip_degC is None else limits.temperature_trip_degC
        self._low_C = -inf if limits.temperature_trip_degC is None else limits.temperature_low_degC
        self._frozen_ns = inf if limits.temperature_frozen_s is None else 1e9 * limits.temperature_frozen_s

    def clear(self) -> None:
        """Discard the earlier samples."""
        self._last_C, self._since_ns = nan, 0
        self.count.clear()

    def check(self, temperature_C: float, now_ns: int) -> Cause:
        """Trip above the limit, and after `STRANGE_SAMPLES` implausible samples, counted with a leak.

        Parameters
        ----------
        temperature_C
            Temperature read [degC]; nan: the device gives none.
        now_ns
            Monotonic time of the reading [ns].
        """
        if self._high_C == inf:
            return Cause.NONE
        if temperature_C > self._high_C:
            return Cause.TEMPERATURE
        if temperature_C != self._last_C:
            self._last_C, self._since_ns = temperature_C, now_ns
        elif now_ns - self._since_ns >= self._frozen_ns:
            return Cause.TEMPERATURE_SENSOR
        if temperature_C >= self._low_C:
            if self.count.level:
                self.count.leak()
            return Cause.NONE
        return Cause.TEMPERATURE_SENSOR if self.count.add() else Cause.NONE
