"""The limiter: the last step before the wire, and the only way to the voltage register."""

from math import inf, isfinite, sqrt

from piezod.config import LimitsConfig


class Limiter:
    """Limits a voltage to a finite number inside range, slew and acceleration, rounded to the converter's step.

    A command without an acknowledgement may or may not have reached the device. Until the next acknowledged command,
    the limiter allows only voltages within the slew of both possibilities.

    Parameters
    ----------
    limits
        Range, converter step, slew and acceleration of the amplifier.
    dt_s
        Tick period [s].

    Attributes
    ----------
    at_once
        Whether the deceleration limit holds in place of the acceleration limit: a stop or a fault moves the output.
    lowest_sent_V, highest_sent_V
        Range of the voltages that the device may have in force [V].
    """

    __slots__ = (
        "_acceleration_V",
        "_applied_V",
        "_deceleration_V",
        "_dt_s",
        "_fall_V",
        "_high_V",
        "_last_change_V",
        "_low_V",
        "_rise_V",
        "_step_V",
        "at_once",
        "highest_sent_V",
        "lowest_sent_V",
    )

    def __init__(self, limits: LimitsConfig, dt_s: float) -> None:
        self._dt_s = dt_s
        self._last_change_V = 0.0
        self.at_once = False
        self.set_limits(limits)
        self.applied_V = limits.voltage_safe_V

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the voltage in force stays."""
        self._low_V, self._high_V = limits.voltage_min_V, limits.voltage_max_V
        self._step_V = limits.voltage_step_V
        self._rise_V = limits.slew_V_per_s * self._dt_s
        self._fall_V = limits.fall_V_per_s * self._dt_s
        self._acceleration_V = (limits.acceleration_V_per_s2 or inf) * self._dt_s**2
        self._deceleration_V = (limits.deceleration_V_per_s2 or inf) * self._dt_s**2

    @property
    def braking_V(self) -> float:
        """Way that the output still rises if a stop or a fault comes now [V]."""
        change, deceleration = self._last_change_V, self._deceleration_V
        return 0.5 * change * (change - deceleration) / deceleration if change > deceleration else 0.0

    @property
    def span_V(self) -> float:
        """Width of the permitted range [V]."""
        return self._high_V - self._low_V

    @property
    def applied_V(self) -> float:
        """Voltage that the device acknowledged last [V]; set it when the output is known from a readback."""
        return self._applied_V

    @applied_V.setter
    def applied_V(self, voltage_V: float) -> None:
        self._applied_V = self.lowest_sent_V = self.highest_sent_V = voltage_V
        self._last_change_V = 0.0

    def acknowledged(self, voltage_V: float) -> None:
        """Note that the device has acknowledged the voltage `voltage_V` [V]."""
        self._last_change_V = voltage_V - self._applied_V
        self._applied_V = self.lowest_sent_V = self.highest_sent_V = voltage_V

    def perhaps_sent(self, voltage_V: float) -> None:
        """Note that the device may have received the voltage `voltage_V` [V]."""
        if isfinite(voltage_V):
            self.lowest_sent_V = min(self.lowest_sent_V, voltage_V)
            self.highest_sent_V = max(self.highest_sent_V, voltage_V)

    def limit(self, planned_V: float, change_V: float = inf, share: float = 1.0) -> float:
        """Nearest permitted voltage [V].

        Parameters
        ----------
        planned_V
            Voltage that the compensator planned [V]. A value that is not finite keeps the voltage in force.
        change_V
            Largest change from the voltage in force [V], where it is smaller than the slew limit.
        share
            Time since the last command [ticks], 0 to 1.
        """
        voltage_V = self.nearest(planned_V if isfinite(planned_V) else self._applied_V)
        acceleration_V = self._deceleration_V if self.at_once else self._acceleration_V
        if acceleration_V != inf:
            voltage_V = self._accelerated(voltage_V, acceleration_V)
            if self.at_once:  # a slower rate is reached within the deceleration too
                change_V = max(change_V, abs(self._last_change_V) - acceleration_V)
        low = self.highest_sent_V - min(change_V, self._fall_V) * share
        high = self.lowest_sent_V + min(change_V, self._rise_V) * share
        if voltage_V > high:
            voltage_V = high
        elif voltage_V < low:
            voltage_V = low
        return voltage_V if self._step_V == 0.0 else self._rounded(voltage_V, low, high)

    def nearest(self, planned_V: float) -> float:
        """Nearest voltage inside the range [V]; slew and acceleration are ignored."""
        return min(max(planned_V, self._low_V), self._high_V)

    def _accelerated(self, planned_V: float, acceleration: float) -> float:
        """Voltage [V] whose change can still stop at `planned_V`, and differs by one acceleration from the last change.

        Stopping from a change d with the acceleration A per tick covers d(d + A) / 2A. The largest d that stops within
        a gap g follows from it.
        """
        last = self._last_change_V
        gap = planned_V - self._applied_V
        braked = 0.5 * acceleration * (sqrt(1.0 + 8.0 * abs(gap) / acceleration) - 1.0)
        change = min(gap, braked) if gap >= 0.0 else max(gap, -braked)
        return self.nearest(self._applied_V + min(max(change, last - acceleration), last + acceleration))

    def _rounded(self, voltage_V: float, low: float, high: float) -> float:
        """Nearest multiple of the converter's step inside range and slew; without one, the voltage in force [V]."""
        if self._low_V <= self._applied_V <= self._high_V:
            low, high = max(low, self._low_V), min(high, self._high_V)
        nearest = round(voltage_V / self._step_V) * self._step_V
        if nearest > high:
            nearest -= self._step_V
        elif nearest < low:
            nearest += self._step_V
        return nearest if low <= nearest <= high else self._applied_V
