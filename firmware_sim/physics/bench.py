"""The emulated bench without firmware, for tests and for studies in virtual time.

>>> bench = Bench("stack", seed=1)
>>> bench.set_voltage(100.0)
>>> bench.advance(0.01)
>>> bench.sample().heartbeat
40
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_sim.physics.compiled_cache import remove_outdated_kernels
from firmware_sim.physics.kernels import advance, run, take_first_sample
from firmware_sim.physics.parameters import initial_state, parameter_record
from firmware_sim.physics.scenario import Scenario, load_scenario

CYCLE_V_PER_S = 140.0  # rate of the drive before power-on (`stack.driven_to_V`)
REST_S = 1.0  # after this drive


@dataclass(frozen=True)
class Sample:
    """The last sample of the device.

    `heartbeat` counts the samples of the device and wraps at 65536. `status` is a sum of the STATUS bits of
    `layout.py`.
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
        Physics of the bench: a scenario, or the name of a scenario of the package.
    seed
        Seed of noise and phases; None draws one from the operating system.
    """

    def __init__(self, scenario: Scenario | str = "stack", *, seed: int | None = None) -> None:
        self.scenario = load_scenario(scenario) if isinstance(scenario, str) else scenario
        remove_outdated_kernels()
        generator = np.random.Generator(np.random.PCG64(seed))
        self._parameters = parameter_record(self.scenario, generator)
        self._state = initial_state(self._parameters, generator)
        self._remainder_s = 0.0
        take_first_sample(self._state, self._parameters)
        if self.scenario.stack.driven_to_V > 0.0:
            self._drive_before_power_on(self.scenario.stack.driven_to_V)

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
        """Rate of the device clock relative to the clock of the client (1)."""
        skew = self.scenario.effects.clock_skew
        return 1.0 + 1e-6 * skew.skew_ppm if skew else 1.0

    @property
    def true_force_N(self) -> float:
        """True force on the load cell [N]."""
        return float(self._state["true_force_N"][0])

    @property
    def output_V(self) -> float:
        """Output of the amplifier [V]."""
        return float(self._state["output_V"][0])

    @property
    def command_V(self) -> float:
        """Commanded voltage [V]; a new one acts from the next physics step and resets the watchdog."""
        return float(self._state["command_V"][0])

    @command_V.setter
    def command_V(self, voltage_V: float) -> None:
        state = self._state[0]
        state["command_V"] = voltage_V
        state["steps_since_command"] = 0
        state["tripped"] = 0

    def set_voltage(self, voltage_V: float) -> None:
        """Command a voltage [V]."""
        self.command_V = voltage_V

    def set_watchdog(self, timeout_s: float, *, safe_V: float, ramp_V_per_s: float) -> None:
        """Set the watchdog: after `timeout_s` without a command the output ramps to `safe_V`; 0: off."""
        self._parameters[0]["safe_V"] = safe_V
        self._parameters[0]["watchdog_ramp_V_per_s"] = ramp_V_per_s
        self._state[0]["watchdog_steps"] = round(timeout_s / self.step_s)

    def feed_watchdog(self) -> None:
        """Restart the timeout of the watchdog without a new voltage; a tripped watchdog stays tripped."""
        self._state[0]["steps_since_command"] = 0

    def set_fault(self, bits: int) -> None:
        """Set the fault bits: 8 amplifier fault, 16 over-temperature, 32 mains lost, 0 none."""
        self._state[0]["fault_bits"] = bits & 56

    def advance(self, duration_s: float) -> None:
        """Advance device time [s] in whole physics steps; the remainder counts for the next call."""
        self._remainder_s += duration_s
        steps = int(self._remainder_s / self.step_s + 1e-6)
        self._remainder_s -= steps * self.step_s
        self.advance_steps(steps)

    def advance_steps(self, steps: int) -> None:
        """Advance by a number of physics steps."""
        if steps > 0:
            advance(self._state, self._parameters, steps)

    def warm_up(self) -> None:
        """Load the compiled physics, so that the first step takes no longer than the others."""
        advance(self._state, self._parameters, 0)

    def sample(self) -> Sample:
        """Return the last sample of the device."""
        state = self._state[0]
        return Sample(
            float(state["reading_N"]),
            float(state["readback_V"]),
            float(state["temperature_reading_C"]),
            int(state["samples"]) & 0xFFFF,
            int(state["status"]),
        )

    def run(self, voltage_V: ArrayLike, dt_s: float, *, interpolate: bool = False) -> NDArray[np.float64]:
        """Drive the bench with a record of commands; return its readings.

        Parameters
        ----------
        voltage_V
            Commands, shape (n,) [V]. Command k acts from k dt to (k+1) dt.
        dt_s
            Spacing of the commands on the clock of the client [s], at least two physics steps.
        interpolate
            False: a command is held. True: the voltage runs straight to the next command.

        Returns
        -------
        numpy.ndarray
            Readings, shape (n,) [N]. Reading k is at time k dt of the device clock, just before command k acts.
        """
        commands = np.ascontiguousarray(voltage_V, dtype=np.float64)
        index = np.arange(commands.size)
        ticks = np.rint(index * (dt_s / self.step_s)).astype(np.int64)
        ends = np.rint(index * (dt_s * self.clock_rate / self.step_s)).astype(np.int64)
        force_N = np.zeros(commands.size)
        if commands.size:
            run(self._state, self._parameters, commands, ticks, ends, force_N, interpolate)
        return force_N

    def _drive_before_power_on(self, peak_V: float) -> None:
        """Drive the stack to a voltage and back, let it rest, and tare the force."""
        rise = np.arange(0.0, peak_V, CYCLE_V_PER_S * 1e-3)
        rest = np.zeros(int(REST_S / 1e-3))
        self.run(np.concatenate([rise, rise[::-1], rest]), 1e-3)
        self._parameters[0]["tare_N"] = self.true_force_N
        for name in ("steps", "samples", "steps_since_command"):
            self._state[0][name] = 0
