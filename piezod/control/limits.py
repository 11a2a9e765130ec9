"""The limiter: the last thing before the wire, and the only way to the voltage register."""

from math import inf, isfinite, sqrt

from piezod.config import LimitsConfig


class Limiter:
    """Hold a voltage finite, inside its range, on the converter's lattice, within slew and acceleration.

    A command that was sent and not acknowledged may stand at the device or not; until the next acknowledged one, what
    is permitted is within the slew of both.

    Parameters
    ----------
    limits
        Range, step, slew and acceleration of the amplifier.
    dt_s
        Tick period [s].
    """

    __slots__ = (
        "_acceleration_V",
        "_applied_V",
        "_dt_s",
        "_fall_V",
        "_high_V",
        "_last_change_V",
        "_low_V",
        "_rise_V",
        "_step_V",
        "clamped",
        "highest_sent_V",
        "lowest_sent_V",
        "refused",
        "slewed",
    )

    def __init__(self, limits: LimitsConfig, dt_s: float) -> None:
        self._dt_s = dt_s
        self._last_change_V = 0.0
        self.clamped = 0
        self.slewed = 0
        self.refused = 0
        self.take_limits(limits)
        self.applied_V = limits.voltage_safe_V

    def take_limits(self, limits: LimitsConfig) -> None:
        """Limit by these from now on; the voltage in force stays."""
        self._low_V, self._high_V = limits.voltage_min_V, limits.voltage_max_V
        self._step_V = limits.voltage_step_V
        self._rise_V = limits.slew_V_per_s * self._dt_s
        self._fall_V = limits.fall_V_per_s * self._dt_s
        acceleration = limits.acceleration_V_per_s2
        self._acceleration_V = inf if acceleration is None else acceleration * self._dt_s**2

    @property
    def applied_V(self) -> float:
        """The voltage that the device acknowledged last [V]; set once it is known from elsewhere."""
        return self._applied_V

    @applied_V.setter
    def applied_V(self, voltage_V: float) -> None:
        self._applied_V = self.lowest_sent_V = self.highest_sent_V = voltage_V
        self._last_change_V = 0.0

    def acknowledged(self, voltage_V: float) -> None:
        """The device took this voltage [V]."""
        self._last_change_V = voltage_V - self._applied_V
        self._applied_V = self.lowest_sent_V = self.highest_sent_V = voltage_V

    def perhaps_sent(self, voltage_V: float) -> None:
        """The device may have taken this voltage [V], or not."""
        if isfinite(voltage_V):
            self.lowest_sent_V = min(self.lowest_sent_V, voltage_V)
            self.highest_sent_V = max(self.highest_sent_V, voltage_V)

    def limit(self, wished_V: float, change_V: float = inf, share: float = 1.0) -> float:
        """Nearest permitted voltage [V].

        Parameters
        ----------
        wished_V
            What the compensator planned; anything not finite leaves the voltage where it is and is counted.
        change_V
            Largest change from the voltage applied before, if smaller than the slew limit allows.
        share
            Part of a tick that has passed since the last command, at most 1.
        """
        if not isfinite(wished_V):
            self.refused += 1
            wished_V = self._applied_V
        if wished_V > self._high_V:
            wished_V = self._high_V
            self.clamped += 1
        elif wished_V < self._low_V:
            wished_V = self._low_V
            self.clamped += 1
        low = self.highest_sent_V - min(change_V, self._fall_V) * share
        high = self.lowest_sent_V + min(change_V, self._rise_V) * share
        if self._acceleration_V != inf:
            wished_V = self._accelerated(wished_V)
        if wished_V > high:
            wished_V = high
            self.slewed += 1
        elif wished_V < low:
            wished_V = low
            self.slewed += 1
        return wished_V if self._step_V == 0.0 else self._on_lattice(wished_V, low, high)

    def nearest(self, wished_V: float) -> float:
        """The wished voltage inside the range [V], whatever the slew."""
        return min(max(wished_V, self._low_V), self._high_V)

    def _accelerated(self, wished_V: float) -> float:
        """Change no faster than what can be braked before the wish, and by one acceleration from the last change.

        Braking from a change d by A a tick covers d(d + A) / 2A; the greatest d that ends at a gap g follows from it.
        """
        acceleration, last = self._acceleration_V, self._last_change_V
        gap = wished_V - self._applied_V
        braked = 0.5 * acceleration * (sqrt(1.0 + 8.0 * abs(gap) / acceleration) - 1.0)
        change = min(gap, braked) if gap >= 0.0 else max(gap, -braked)
        return self.nearest(self._applied_V + min(max(change, last - acceleration), last + acceleration))

    def _on_lattice(self, voltage_V: float, low: float, high: float) -> float:
        """Nearest multiple of the converter's step that exceeds neither range nor slew; what was applied if none is."""
        if self._low_V <= self._applied_V <= self._high_V:
            low, high = max(low, self._low_V), min(high, self._high_V)
        nearest = round(voltage_V / self._step_V) * self._step_V
        if nearest > high:
            nearest -= self._step_V
        elif nearest < low:
            nearest += self._step_V
        return nearest if low <= nearest <= high else self._applied_V
