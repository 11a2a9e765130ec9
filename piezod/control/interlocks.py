"""What is watched in every good reading: each interlock keeps what it needs and says when its limit is passed.

All are plain floats and integers, made once; nothing is allocated in a tick. `begin` is called when the bench is armed,
`judge` with every good reading while it is driven.
"""

from math import inf, isfinite, nan, pi

from piezod.config import LimitsConfig
from piezod.control.states import Cause

STATUS_WATCHDOG = 2
STATUS_AMPLIFIER_FAULT = 8
STATUS_OVER_TEMPERATURE = 16
STATUS_MAINS_LOST = 32
STATUS_FAULTS = STATUS_AMPLIFIER_FAULT | STATUS_OVER_TEMPERATURE | STATUS_MAINS_LOST


class ForceInterlock:
    """Force above, below, or risen faster than is possible; a single wrong sample is counted and does not trip.

    A sample is implausible when it lies further from the last plausible one than the greatest rate explains in the time
    between them. A spike is over with the next sample, a jump is not.

    Attributes
    ----------
    suspicious
        The last sample was outside a limit: the voltage must not rise until the next one says more.
    spikes
        Suspicions that were not confirmed.
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
        "suspicious",
    )

    def __init__(self, limits: LimitsConfig) -> None:
        self._max_N, self._min_N = limits.force_trip_N, limits.force_min_N
        self._rate_N_per_ns = inf if limits.force_rate_trip_N_per_s is None else 1e-9 * limits.force_rate_trip_N_per_s
        self._needed = limits.force_debounce_samples
        self.spikes = 0
        self.suspicious = False
        self.begin()

    def begin(self) -> None:
        """Forget the samples before."""
        self._force_N, self._time_ns = nan, 0
        self._in_a_row = 0
        self.suspicious = False

    def judge(self, force_N: float, now_ns: int) -> Cause:
        """Say which limit is passed, Cause.NONE as long as none is or the debounce runs."""
        cause = Cause.NONE
        if force_N > self._max_N:
            cause = Cause.OVER_FORCE
        elif force_N < self._min_N:
            cause = Cause.UNDER_FORCE
        elif abs(force_N - self._force_N) > self._rate_N_per_ns * (now_ns - self._time_ns):  # never, with nan
            cause = Cause.FORCE_RATE
        if cause is Cause.NONE:
            self.spikes += self.suspicious
            self._force_N, self._time_ns, self._in_a_row = force_N, now_ns, 0
            self.suspicious = False
            return cause
        self._in_a_row += 1
        self.suspicious = True
        return cause if self._in_a_row >= self._needed else Cause.NONE


class StuckInterlock:
    """Equal force readings, one after the other, while the voltage moves."""

    __slots__ = ("_equal", "_force_N", "_heartbeat", "_high_V", "_low_V", "_samples", "_travel_V")

    def __init__(self, limits: LimitsConfig) -> None:
        self._samples = limits.stuck_samples or 0
        self._travel_V = limits.stuck_travel_V
        self.begin()

    def begin(self) -> None:
        """Forget the samples before."""
        self._force_N, self._heartbeat, self._equal = nan, -1, 0
        self._low_V = self._high_V = 0.0

    def judge(self, force_N: float, heartbeat: int, written_V: float) -> Cause:
        """Count new samples (the heartbeat moved, or there is none); one that differs starts again."""
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
    """The voltage read back lies outside what was commanded lately.

    The amplifier needs time to follow, so the band is what was commanded within the last one to two
    `readback_trip_ms`: two stretches of that length, of which the older is dropped.
    """

    __slots__ = ("_before_high", "_before_low", "_begun_ns", "_high", "_low", "_outside", "_stretch_ns", "_trip_V")

    def __init__(self, limits: LimitsConfig) -> None:
        self._trip_V = inf if limits.readback_trip_V is None else limits.readback_trip_V
        self._stretch_ns = round(1e6 * limits.readback_trip_ms)
        self.begin()

    def begin(self) -> None:
        """Forget what was commanded before."""
        self._low = self._before_low = inf
        self._high = self._before_high = -inf
        self._begun_ns = self._outside = 0

    def judge(self, readback_V: float, written_V: float, now_ns: int) -> Cause:
        """Two samples in a row outside the band: one could be a spike of the monitor."""
        if now_ns - self._begun_ns > self._stretch_ns:
            self._before_low, self._before_high = self._low, self._high
            self._low = self._high = written_V
            self._begun_ns = now_ns
        self._low, self._high = min(self._low, written_V), max(self._high, written_V)
        low, high = min(self._low, self._before_low), max(self._high, self._before_high)
        inside = low - self._trip_V <= readback_V <= high + self._trip_V
        self._outside = 0 if inside or not isfinite(readback_V) else self._outside + 1
        return Cause.READBACK if self._outside > 1 else Cause.NONE


class TrackingInterlock:
    """Force far from the reference whose voltage was written unchanged: then the model says they are equal."""

    __slots__ = ("_due_N", "_lasting_ns", "_since_ns", "_trip_N")

    def __init__(self, limits: LimitsConfig) -> None:
        self._trip_N = inf if limits.tracking_trip_N is None else limits.tracking_trip_N
        self._lasting_ns = round(1e6 * limits.tracking_trip_ms)
        self.begin()

    def begin(self) -> None:
        """Forget the error before."""
        self._due_N, self._since_ns = nan, -1

    def judge(self, force_N: float, reference_N: float, now_ns: int) -> Cause:
        """Compare with the reference of the exchange before; `reference_N` is nan where none could be followed."""
        due_N, self._due_N = self._due_N, reference_N
        if not isfinite(due_N):
            return Cause.NONE
        if abs(force_N - due_N) <= self._trip_N:
            self._since_ns = -1
            return Cause.NONE
        if self._since_ns < 0:
            self._since_ns = now_ns
        return Cause.TRACKING if now_ns - self._since_ns >= self._lasting_ns else Cause.NONE


class HeatInterlock:
    """Power that the stack turns into heat, from the voltage alone.

    A full cycle between two voltages s apart loses E = pi C tan(delta) s^2, so P = pi f C tan(delta) Vpp^2; half of it
    is lost on the way up and half on the way down, and within one way dE = pi C tan(delta) s ds, s counted from the
    last reversal. Reversals smaller than a hundredth of the range are ripple. The mean fades over `dissipation_over_s`.

    Attributes
    ----------
    power_W
        The mean now.
    """

    __slots__ = ("_extreme_V", "_factor", "_max_W", "_ripple_V", "_rising", "_share", "_turn_V", "_watched", "power_W")

    def __init__(self, limits: LimitsConfig, dt_s: float) -> None:
        self._watched = limits.dissipation_max_W is not None
        self._max_W = limits.dissipation_max_W or inf
        self._factor = 0.5 * pi * limits.capacitance_F * (limits.loss_tangent or 0.0) / limits.dissipation_over_s
        self._share = dt_s / limits.dissipation_over_s
        self._ripple_V = 0.01 * (limits.voltage_max_V - limits.voltage_min_V)
        self._turn_V = self._extreme_V = limits.voltage_safe_V
        self._rising = True
        self.power_W = 0.0

    def judge(self, written_V: float) -> Cause:
        """Add what the last change has turned into heat; heat stays when the bench is disarmed."""
        if not self._watched:
            return Cause.NONE
        beyond_V = written_V - self._extreme_V if self._rising else self._extreme_V - written_V
        self.power_W -= self._share * self.power_W
        if beyond_V > 0.0:
            before_V, self._extreme_V = self._extreme_V, written_V
            self._add(before_V)
        elif beyond_V < -self._ripple_V:
            self._turn_V, self._extreme_V = self._extreme_V, written_V
            self._rising = not self._rising
            self._add(self._turn_V)
        return Cause.OVERHEATED if self.power_W > self._max_W else Cause.NONE

    def _add(self, before_V: float) -> None:
        """Heat of the way from `before_V` to the extreme."""
        self.power_W += self._factor * ((self._extreme_V - self._turn_V) ** 2 - (before_V - self._turn_V) ** 2)
