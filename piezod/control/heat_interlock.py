"""The interlock of the heat in the stack; called like those of `interlocks.py`, and never cleared."""

from math import inf, pi

from piezod.config import LimitsConfig
from piezod.control.states import Cause


class HeatInterlock:
    """Mean power that the stack turns into heat, computed from the voltage.

    A full cycle with the peak-to-peak voltage s loses E = pi C tan(delta) s^2, so P = pi f C tan(delta) s^2. Half of E
    is lost on the way up and half on the way down: dE = pi C tan(delta) s ds, with s counted from the last reversal.
    Reversals smaller than 1 % of the range are ripple. The mean decays with the time constant `dissipation_over_s`.

    Parameters
    ----------
    limits
        Largest power [W], capacitance [F], loss tangent [1], time constant [s].
    dt_s
        Tick period [s].

    Attributes
    ----------
    power_W
        Mean power now [W]. It survives disarming and new limits, because the heat does. Set it to continue a sum.
    """

    __slots__ = (
        "_checked",
        "_dt_s",
        "_extreme_V",
        "_factor",
        "_max_W",
        "_ripple_V",
        "_rising",
        "_share",
        "_turn_V",
        "power_W",
    )

    def __init__(self, limits: LimitsConfig, dt_s: float) -> None:
        self._dt_s = dt_s
        self._turn_V = self._extreme_V = limits.voltage_safe_V
        self._rising = True
        self.power_W = 0.0
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the heat and the last reversal stay."""
        self._checked = limits.dissipation_max_W is not None
        self._max_W = limits.dissipation_max_W or inf
        self._factor = 0.5 * pi * limits.capacitance_F * (limits.loss_tangent or 0.0) / limits.dissipation_over_s
        self._share = self._dt_s / limits.dissipation_over_s
        self._ripple_V = 0.01 * (limits.voltage_max_V - limits.voltage_min_V)

    def check(self, written_V: float) -> Cause:
        """Add the heat of the last change of voltage.

        Parameters
        ----------
        written_V
            Voltage in force [V].
        """
        if not self._checked:
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
        """Add the heat of the way from `before_V` [V] to the extreme."""
        self.power_W += self._factor * ((self._extreme_V - self._turn_V) ** 2 - (before_V - self._turn_V) ** 2)
