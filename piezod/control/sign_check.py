"""The sign check: a small voltage step after arming, which must raise the force."""

from math import ceil

from piezod.config.sections import SignCheckConfig

FEWEST_SAMPLES = 4  # of one window, at any tick rate


class SignCheck:
    """A voltage step up from rest and back; the mean force must rise with it.

    The check has two windows, one at rest and one at the step. The force is averaged over the second half of each; the
    first half is for settling.

    Parameters
    ----------
    config
        Step [V], least rise [N] and window length [s].
    dt_s
        Tick period [s].
    converter_step_V
        Resolution of the output [V]: the applied voltage comes only so near to the planned voltage.

    Attributes
    ----------
    window
        Length of one window [ticks].
    step_V
        Height of the step [V].
    passed
        True when the force has risen by at least `config.rise_N`.
    done
        True when the check has passed and the output is back at its start.
    """

    __slots__ = (
        "_config",
        "_count",
        "_rest_N",
        "_rest_V",
        "_sum_N",
        "_ticks",
        "_tolerance_V",
        "done",
        "passed",
        "step_V",
        "window",
    )

    def __init__(self, config: SignCheckConfig, dt_s: float, converter_step_V: float = 0.0) -> None:
        self._config = config
        self.step_V = config.step_V
        self._tolerance_V = max(0.1 * config.step_V, converter_step_V)
        self.window = max(FEWEST_SAMPLES, ceil(config.settle_s / dt_s))
        self.start(0.0)

    def start(self, rest_V: float) -> None:
        """Begin the check at the voltage `rest_V` [V]."""
        self._rest_V, self._rest_N = rest_V, 0.0
        self._ticks = self._count = 0
        self._sum_N = 0.0
        self.done = self.passed = False

    def plan_voltage(self, applied_V: float) -> float:
        """Voltage of this tick [V]: rest, step, then rest again. `applied_V` is the voltage in force [V]."""
        if self._ticks < self.window or self.passed:
            self.done = self.passed and abs(applied_V - self._rest_V) <= self._tolerance_V
            return self._rest_V
        return self._rest_V + self._config.step_V

    def add_reading(self, force_N: float, applied_V: float) -> bool:
        """Add a good reading; False when the step is over and the force has not risen.

        Parameters
        ----------
        force_N
            Force read [N].
        applied_V
            Voltage in force [V].
        """
        stepped = self._ticks >= self.window
        if self.passed or (stepped and abs(applied_V - self._rest_V - self._config.step_V) > self._tolerance_V):
            return True  # the output is on its way to the step, or back
        self._ticks += 1
        tick = self._ticks - self.window if stepped else self._ticks
        if 2 * tick > self.window:
            self._sum_N += force_N
            self._count += 1
        if tick < self.window:
            return True
        mean_N, self._sum_N, self._count = self._sum_N / self._count, 0.0, 0
        if not stepped:
            self._rest_N = mean_N
            return True
        self.passed = mean_N - self._rest_N >= self._config.rise_N
        return self.passed
