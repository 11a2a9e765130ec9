"""The limiter: the last thing before the wire, and the only way to the voltage register."""

from math import isfinite

from piezod.config import LimitsConfig


class Limiter:
    """Hold a voltage finite, inside its range, on the converter's lattice and within the slew from the one before.

    Parameters
    ----------
    limits
        Range, step and slew of the amplifier.
    dt_s
        Tick period [s].
    """

    __slots__ = ("_change_V", "_high_V", "_low_V", "_step_V", "applied_V", "clamped", "refused", "slewed")

    def __init__(self, limits: LimitsConfig, dt_s: float) -> None:
        self._low_V = limits.voltage_min_V
        self._high_V = limits.voltage_max_V
        self._step_V = limits.voltage_step_V
        self._change_V = limits.slew_V_per_s * dt_s
        self.applied_V = limits.voltage_safe_V
        self.clamped = 0
        self.slewed = 0
        self.refused = 0

    def limit(self, wished_V: float, change_V: float = float("inf")) -> float:
        """Nearest permitted voltage [V].

        Parameters
        ----------
        wished_V
            What the compensator planned; anything not finite leaves the voltage where it is and is counted.
        change_V
            Largest change from the voltage applied before, if smaller than the slew limit allows.
        """
        applied = self.applied_V
        if not isfinite(wished_V):
            self.refused += 1
            wished_V = applied
        if wished_V > self._high_V:
            wished_V = self._high_V
            self.clamped += 1
        elif wished_V < self._low_V:
            wished_V = self._low_V
            self.clamped += 1
        change_V = min(change_V, self._change_V)
        if wished_V > applied + change_V:
            wished_V = applied + change_V
            self.slewed += 1
        elif wished_V < applied - change_V:
            wished_V = applied - change_V
            self.slewed += 1
        return wished_V if self._step_V == 0.0 else self._on_lattice(wished_V, change_V)

    def nearest(self, wished_V: float) -> float:
        """The wished voltage inside the range [V], whatever the slew."""
        return min(max(wished_V, self._low_V), self._high_V)

    def _on_lattice(self, voltage_V: float, change_V: float) -> float:
        """Nearest multiple of the converter's step that exceeds neither range nor slew."""
        low = max(self._low_V, self.applied_V - change_V)
        high = min(self._high_V, self.applied_V + change_V)
        nearest = round(voltage_V / self._step_V) * self._step_V
        if nearest > high:
            nearest -= self._step_V
        elif nearest < low:
            nearest += self._step_V
        return nearest if low <= nearest <= high else self.applied_V
