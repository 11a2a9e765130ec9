"""The emulated bench without its firmware: for tests, and for studies in virtual time.

>>> bench = Bench("stack", seed=1)
>>> bench.set_voltage(100.0)
>>> bench.advance(0.01)
>>> bench.sample().heartbeat
40
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_sim.physics.compiled_cache import forget_outdated_kernels
from firmware_sim.physics.kernels import advance, begin, run
from firmware_sim.physics.parameters import initial_state, parameter_record
from firmware_sim.physics.scenario import Scenario, load_scenario

CYCLE_V_PER_S = 140.0  # how fast a stack that comes used was driven up and down
REST_S = 1.0


@dataclass(frozen=True)
class Sample:
    """What the firmware last read.

    `heartbeat` counts the device's samples and wraps at 65536; `status` is a sum of the bits in `layout.py`.
    """

    force_N: float
    voltage_readback_V: float
    temperature_C: float
    heartbeat: int
    status: int


class Bench:
    """One emulated bench.

    Parameters
    ----------
    scenario
        Its physics: a scenario, or the name of one that comes with the package.
    seed
        Of its noise and phases; None draws one from the operating system.
    """

    def __init__(self, scenario: Scenario | str = "stack", *, seed: int | None = None) -> None:
        self.scenario = load_scenario(scenario) if isinstance(scenario, str) else scenario
        forget_outdated_kernels()
        generator = np.random.Generator(np.random.PCG64(seed))
        self._parameters = parameter_record(self.scenario, generator)
        self._state = initial_state(self._parameters, generator)
        self._owed_s = 0.0
        begin(self._state, self._parameters)
        if self.scenario.stack.driven_to_V > 0.0:
            self._drive_before(self.scenario.stack.driven_to_V)

    @property
    def step_s(self) -> float:
        """The physics step [s]."""
        return self.scenario.step_s

    @property
    def time_s(self) -> float:
        """Device time since power-on [s]."""
        return float(self._state["steps"][0]) * self.step_s

    @property
    def clock_rate(self) -> float:
        """Device seconds that pass in a second of the client's clock."""
        skew = self.scenario.effects.clock_skew
        return 1.0 + 1e-6 * skew.skew_ppm if skew else 1.0

    @property
    def true_force_N(self) -> float:
        """The force on the load cell, before it is measured [N]."""
        return float(self._state["true_force_N"][0])

    @property
    def output_V(self) -> float:
        """The amplifier's output [V]."""
        return float(self._state["output_V"][0])

    @property
    def command_V(self) -> float:
        """The voltage commanded [V]; a new one acts from the next physics step and calms the watchdog."""
        return float(self._state["command_V"][0])

    @command_V.setter
    def command_V(self, voltage_V: float) -> None:
        state = self._state[0]
        state["command_V"] = voltage_V
        state["quiet_steps"] = 0
        state["tripped"] = 0

    def set_voltage(self, voltage_V: float) -> None:
        """Command a voltage [V]."""
        self.command_V = voltage_V

    def set_watchdog(self, timeout_s: float, *, safe_V: float, ramp_V_per_s: float) -> None:
        """Arm the dead-man's switch: after `timeout_s` without a command the output ramps to `safe_V`; 0 disarms it."""
        self._parameters[0]["safe_V"] = safe_V
        self._parameters[0]["watchdog_ramp_V_per_s"] = ramp_V_per_s
        self._state[0]["watchdog_steps"] = round(timeout_s / self.step_s)

    def feed_watchdog(self) -> None:
        """Calm the dead-man's switch without a new voltage; one that has tripped stays tripped."""
        self._state[0]["quiet_steps"] = 0

    def set_fault(self, bits: int) -> None:
        """Raise (or, with 0, clear) the bits 8 amplifier fault, 16 over-temperature, 32 mains lost."""
        self._state[0]["fault_bits"] = bits & 56

    def advance(self, duration_s: float) -> None:
        """Let device time pass [s], in whole physics steps; what is left over counts for the next call."""
        self._owed_s += duration_s
        steps = int(self._owed_s / self.step_s + 1e-6)
        self._owed_s -= steps * self.step_s
        self.advance_steps(steps)

    def advance_steps(self, steps: int) -> None:
        """Let physics steps pass."""
        if steps > 0:
            advance(self._state, self._parameters, steps)

    def warm_up(self) -> None:
        """Load the compiled physics, so that the first step costs no more than the others."""
        advance(self._state, self._parameters, 0)

    def sample(self) -> Sample:
        """Return what the firmware last read."""
        state = self._state[0]
        return Sample(
            float(state["reading_N"]),
            float(state["readback_V"]),
            float(state["temperature_reading_C"]),
            int(state["samples"]) & 0xFFFF,
            int(state["status"]),
        )

    def run(self, voltage_V: ArrayLike, dt_s: float, *, interpolate: bool = False) -> NDArray[np.float64]:
        """Drive the bench with a record of commands and return its readings.

        Parameters
        ----------
        voltage_V
            Commands, shape (n,) [V]; command k is held (or with `interpolate` led to the next) from k dt to (k+1) dt.
        dt_s
            Their spacing on the client's clock [s], at least two physics steps.

        Returns
        -------
        numpy.ndarray
            Readings, shape (n,) [N]: reading k stands at time k dt of the device's clock, just before command k acts.
        """
        commands = np.ascontiguousarray(voltage_V, dtype=np.float64)
        index = np.arange(commands.size)
        ticks = np.rint(index * (dt_s / self.step_s)).astype(np.int64)
        ends = np.rint(index * (dt_s * self.clock_rate / self.step_s)).astype(np.int64)
        force_N = np.zeros(commands.size)
        if commands.size:
            run(self._state, self._parameters, commands, ticks, ends, force_N, interpolate)
        return force_N

    def _drive_before(self, peak_V: float) -> None:
        """Drive the stack to a voltage and back, let it rest, and take what force remains for zero."""
        rise = np.arange(0.0, peak_V, CYCLE_V_PER_S * 1e-3)
        rest = np.zeros(int(REST_S / 1e-3))
        self.run(np.concatenate([rise, rise[::-1], rest]), 1e-3)
        self._parameters[0]["tare_N"] = self.true_force_N
        for name in ("steps", "samples", "quiet_steps"):
            self._state[0][name] = 0
