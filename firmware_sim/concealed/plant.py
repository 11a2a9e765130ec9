"""One concealed plant: the chain from the commands of a record to what its reader would show without noise.

    command -> clamp, slew, lag -> hysteresis -> creep, drifting gain -> force law, gap, friction -> temperature, load
    -> mode, vibration -> leakage, low-pass, cross-talk, hum -> delay, the reader's clock

All on a grid some times finer than the record. What happens once or at random (places in time, phases) is in the
effect's details or is drawn from the record's own seed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from firmware_sim.concealed import amplifier, mechanics
from firmware_sim.concealed.arrays import Array
from firmware_sim.concealed.creep import draw_spectrum
from firmware_sim.concealed.drives import Drive
from firmware_sim.concealed.foreign import FOREIGN, Surroundings
from firmware_sim.concealed.hysteresis import Hysteresis
from firmware_sim.concealed.linear import System, first_order, high_pass, respond, second_order
from firmware_sim.concealed.reader import read_at, tone

SHAPES = ("straight", "root", "saturating")


@dataclass(frozen=True)
class Effect:
    """One effect that is on.

    Parameters
    ----------
    name
        As in the catalogue, or of a foreign one.
    parameters
        The catalogue's, by name.
    details
        What else was drawn; no one is asked for it.
    scope
        `already_there` when the plant was identified, or `come_since`.
    """

    name: str
    parameters: dict[str, float]
    details: dict[str, object] = field(default_factory=dict)
    scope: str = "come_since"

    def number(self, detail: str) -> float:
        """A detail that is a number."""
        value = self.details[detail]
        assert isinstance(value, (int, float))
        return float(value)

    def text(self, detail: str) -> str:
        """A detail that is a word."""
        return str(self.details[detail])


Effects = Mapping[str, Effect]


@dataclass(frozen=True)
class Plant:
    """What stays the same whatever effect is on.

    Parameters
    ----------
    hysteresis, noncongruent
        The operator, and the one that takes over a share of it when minor loops shall not be congruent.
    law
        From relative stroke to force.
    """

    hysteresis: Hysteresis
    noncongruent: Hysteresis
    law: mechanics.ForceLaw

    def reading_N(self, drive: Drive, effects: Effects, seed: int) -> Array:
        """Noise-free readings of a record that starts at rest, shape (n,) [N].

        Parameters
        ----------
        drive
            The record's commands.
        effects
            Those that are on.
        seed
            Of what is random in this record besides noise.
        """
        return _Run(self, drive, effects, seed).reading_N()


class _Run:
    """One pass through the chain.

    `stairs` says whether the signal at hand still is a staircase: so it is behind held commands, until something
    smooths it.
    """

    def __init__(self, plant: Plant, drive: Drive, effects: Effects, seed: int) -> None:
        self._plant, self._drive, self._effects = plant, drive, effects
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._phases = self._rng.uniform(0.0, 2.0 * np.pi, 8)
        self._dt_s = drive.fine_s
        self._stairs = drive.held
        self._output_V = np.zeros(0)

    def reading_N(self) -> Array:
        self._output_V = self._foreign("amplifier", self._amplified())
        stroke = self._foreign("stack", self._aged(self._crept(self._deformed(self._output_V))))
        force_N = self._plant.law(stroke / self._plant.hysteresis.reach_V)
        force_N = self._foreign("force", self._rubbed(self._bent(force_N)))
        force_N = self._vibrated(self._swung(self._loaded(force_N)))
        signal_N = self._hummed(self._coupled(self._filtered(self._leaked(force_N))))
        return self._foreign("reading", self._read(signal_N))

    def _time_s(self, points: int) -> Array:
        """Time of the points of the grid, shape (n,) [s]."""
        result: Array = np.asarray(np.arange(points) * self._dt_s, dtype=np.float64)
        return result

    def _respond(self, system: System, values: Array) -> Array:
        result = respond(system, values, self._dt_s, stairs=self._stairs)
        self._stairs = False
        return result

    def _foreign(self, stage: str, values: Array) -> Array:
        for name, effect in self._effects.items():
            if name in FOREIGN and FOREIGN[name].stage == stage:
                dt_s = 1.0 / self._drive.rate_Hz if stage == "reading" else self._dt_s
                place = Surroundings(
                    self._drive, dt_s, self._plant.hysteresis.reach_V, self._plant.law.full_N, self._rng
                )
                values = FOREIGN[name].apply(values, effect.parameters["amount"], effect.details, place)
        return values

    def _amplified(self) -> Array:
        voltage_V = self._drive.fine_voltage_V()
        if on := self._effects.get("voltage_clamp"):
            voltage_V = amplifier.clamp(voltage_V, on.parameters["limit_V"], on.number("knee_V"))
        if on := self._effects.get("slew_limit"):
            voltage_V = amplifier.slew(voltage_V, on.parameters["limit_V_per_s"], self._dt_s)
            self._stairs = False
        if on := self._effects.get("electrical_lag"):
            voltage_V = self._respond(first_order(on.parameters["time_constant_s"]), voltage_V)
        return voltage_V

    def _deformed(self, voltage_V: Array) -> Array:
        core, widening, other = self._plant.hysteresis, None, None
        if on := self._effects.get("rate_dependent_hysteresis"):
            rate = self._rate_V_per_s(voltage_V) / on.parameters["reference_V_per_s"]
            widening = (1.0 + rate) ** on.parameters["growth"]
        if on := self._effects.get("noncongruent_minor_loops"):
            share = on.parameters["share"]
            foreign = self._plant.noncongruent.lagging(voltage_V)
            other = (1.0 - share) * core.lagging(voltage_V, widening) + share * foreign
        return core.run(voltage_V, widening=widening, other=other)

    def _rate_V_per_s(self, voltage_V: Array) -> Array:
        """Rate of the voltage over the last sample period, shape (n,) [V/s]."""
        back = self._drive.substeps
        before = np.concatenate((np.full(back, voltage_V[0]), voltage_V[:-back]))
        result: Array = np.abs(voltage_V - before) * self._drive.rate_Hz
        return result

    def _crept(self, stroke: Array) -> Array:
        on = self._effects.get("creep")
        if on is None:
            return stroke
        shape = np.random.Generator(np.random.PCG64(int(on.number("seed"))))
        spectrum = draw_spectrum(shape, on.text("law"), on.parameters["from_s"], on.parameters["to_s"])
        return stroke + on.parameters["per_decade"] * spectrum.run(stroke, self._dt_s, stairs=self._stairs)

    def _aged(self, stroke: Array) -> Array:
        on = self._effects.get("gain_drift")
        if on is None:
            return stroke
        part = self._time_s(stroke.size) / self._drive.time_s[-1]
        shape = on.text("shape")
        if shape == "root":
            part = np.sqrt(part)
        elif shape == "saturating":
            part = np.expm1(-2.0 * part) / np.expm1(-2.0)
        result: Array = stroke * (1.0 + on.parameters["relative_change"] * part)
        return result

    def _bent(self, force_N: Array) -> Array:
        if on := self._effects.get("output_nonlinearity"):
            full_N, shape = self._plant.law.full_N, on.text("shape")
            amount = mechanics.amount_of(on.parameters["curvature"], shape)
            force_N = full_N * mechanics.bend(force_N / full_N, amount, shape)
        if on := self._effects.get("contact_gap"):
            force_N = mechanics.contact(force_N, on.parameters["gap_N"], on.number("softness_N"))
        return force_N

    def _rubbed(self, force_N: Array) -> Array:
        on = self._effects.get("friction")
        if on is None:
            return force_N
        given = on.parameters
        return force_N - mechanics.rub(force_N, given["force_N"], given["presliding_N"], on.number("exponent"))

    def _loaded(self, force_N: Array) -> Array:
        if on := self._effects.get("thermal_drift"):
            warmth_K = self._drive.fine(self._drive.temperature_C - self._drive.temperature_C[0])
            if on.number("lag_s") > 0.0:
                warmth_K = respond(first_order(on.number("lag_s")), warmth_K, self._dt_s, stairs=False)
            force_N = force_N + on.parameters["coefficient_N_per_K"] * warmth_K
        if on := self._effects.get("load_step"):
            time_s = self._time_s(force_N.size)
            rise_s = on.number("rise_s")
            on_s, off_s = on.parameters["on_s"], on.parameters.get("off_s", np.inf)
            there = np.clip((time_s - on_s) / rise_s, 0.0, 1.0) - np.clip((time_s - off_s) / rise_s, 0.0, 1.0)
            force_N = force_N + on.parameters["step_N"] * there
        return force_N

    def _swung(self, force_N: Array) -> Array:
        on = self._effects.get("resonance")
        if on is None:
            return force_N
        return self._respond(second_order(on.parameters["frequency_Hz"], on.parameters["damping_ratio"]), force_N)

    def _vibrated(self, force_N: Array) -> Array:
        on = self._effects.get("vibration")
        if on is None:
            return force_N
        time_s = self._time_s(force_N.size)
        breath = 1.0 + on.number("breathing") * np.sin(2.0 * np.pi * time_s / on.number("breath_s") + self._phases[0])
        wave = tone(time_s, on.parameters["frequency_Hz"], float(self._phases[1]))
        result: Array = force_N + on.parameters["amplitude_N"] * breath * wave
        return result

    def _leaked(self, force_N: Array) -> Array:
        on = self._effects.get("charge_leakage")
        if on is None:
            return force_N
        # The fast part passes as it came: a staircase stays one.
        leaks = high_pass(on.parameters["time_constant_s"])
        result: Array = respond(leaks, force_N - force_N[0], self._dt_s, stairs=self._stairs) + force_N[0]
        return result

    def _filtered(self, force_N: Array) -> Array:
        on = self._effects.get("sensor_filter")
        if on is None:
            return force_N
        cutoff_Hz = on.parameters["cutoff_Hz"]
        low_pass = first_order(0.5 / np.pi / cutoff_Hz) if on.number("order") < 2 else second_order(cutoff_Hz, 0.5**0.5)
        return self._respond(low_pass, force_N)

    def _coupled(self, force_N: Array) -> Array:
        on = self._effects.get("feedthrough")
        if on is None:
            return force_N
        tau_s = on.number("rise_s")
        rate = respond(high_pass(tau_s), self._output_V, self._dt_s, stairs=self._drive.held) / tau_s
        self._stairs = False
        return force_N + on.parameters["coefficient_N_s_per_V"] * rate

    def _hummed(self, force_N: Array) -> Array:
        on = self._effects.get("mains_hum")
        if on is None:
            return force_N
        time_s = self._time_s(force_N.size)
        frequency_Hz, wave = on.parameters["frequency_Hz"], np.zeros(force_N.size)
        parts = on.details["harmonics"]
        assert isinstance(parts, dict)
        for order, part in {"1": 1.0, **parts}.items():
            wave += part * tone(time_s, int(order) * frequency_Hz, self._phases[2] + self._phases[int(order) % 8])
        return force_N + on.parameters["amplitude_N"] * wave

    def _read(self, signal_N: Array) -> Array:
        """Take the samples: late by the delay, and at the reader's own pace."""
        drive = self._drive
        places = np.arange(drive.voltage_V.size, dtype=np.float64) * drive.substeps
        if on := self._effects.get("clock_skew"):
            places *= 1.0 + 1e-6 * on.parameters["skew_ppm"]
        if on := self._effects.get("transport_delay"):
            places -= on.parameters["delay_s"] / self._dt_s
        return read_at(signal_N, places, stairs=self._stairs)
