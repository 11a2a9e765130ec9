"""Parameters of every effect of the catalogue on the emulated bench, and their reasons.

The noise is 0.1 N. Each strength is realistic for such a bench and changes the force in mixed work by 4 to 20 times
the noise (rms). The study measures this for every case, on the bench without its link.

| effect | reason of the strength |
|---|---|
| electrical_lag | 400 Ohm into 10 uF: a series resistor against ringing |
| slew_limit | 25 mA into 10 uF: met in steps, which the controller drives at 4000 V/s, not in slow work |
| voltage_clamp | a supply that has sagged below the peak of the work |
| rate_dependent_hysteresis | one per cent wider a decade of rate |
| noncongruent_minor_loops | 40 % of the irreversible part depends on the bias, which bends the curve as well |
| creep | 1 % a decade; soft ceramics have 1 to 2 |
| gain_drift | 1.5 % over the record: a stack that warms up |
| output_nonlinearity | a load that stiffens by 2 % towards full force |
| contact_gap | 40 N, above the 35 N that the hysteresis leaves at 0 V: a smaller gap opens in the first rise alone |
| friction | 1.5 N in a guide |
| resonance | a heavy load, 90 Hz |
| thermal_drift | 1.5 N/K in a room that wanders by 1 K: 10 ppm/K, 40 mm, 4 N/um |
| load_step | half a kilogram put on the mount and taken off |
| vibration | a pump at 23.7 Hz |
| charge_leakage | a charge amplifier of 1500 s |
| sensor_filter | a load cell amplifier set to 40 Hz |
| feedthrough | crosstalk of the drive, 0.4 N at 100 V/s, behind an input stage of 50 Hz |
| mains_hum | an open shield |
| sensor_dropout | two pauses of an overloaded converter, in movement |
| quantisation | 12 bits over 4 kN |
| transport_delay | 7 ms over USB; a command is held for a tick of 2 ms, so 6 to 8 ms read alike |
| clock_skew | two crystals, 100 ppm; by two loggers: over a link every reading answers the command before it |
"""

from dataclasses import dataclass, field

NOISE_N = 0.1


@dataclass(frozen=True)
class Switched:
    """The effect of one scenario.

    Parameters
    ----------
    effect
        Name in the catalogue; None: no effect.
    values
        Values for `firmware_sim`.
    parameter
        Name of the compared parameter.
    alike
        Whether the emulated physics uses the parameter as the catalogue defines it.
    over_link
        Whether it is recorded over the link; else by two loggers, command and reading each with its own clock.
    """

    effect: str | None
    values: dict[str, object] = field(default_factory=dict)
    parameter: str = ""
    alike: bool = True
    over_link: bool = True

    @property
    def truth(self) -> float | None:
        """True value of the parameter."""
        if not self.parameter:
            return None
        if self.effect == "sensor_dropout":
            return self.values["places_s"][0][0]
        return float(self.values[self.parameter])


def _one(effect: str, parameter: str, *, alike: bool = True, **values: object) -> Switched:
    return Switched(effect, values, parameter, alike)


SWITCHED = {
    "none": Switched(None),
    "electrical_lag": _one("electrical_lag", "time_constant_s", time_constant_s=0.004),
    "slew_limit": _one("slew_limit", "limit_V_per_s", limit_V_per_s=2500.0),
    "voltage_clamp": _one("voltage_clamp", "limit_V", limit_V=122.0),
    "rate_dependent_hysteresis": _one(
        "rate_dependent_hysteresis", "growth", alike=False, growth=0.005, reference_V_per_s=10.0
    ),
    "noncongruent_minor_loops": _one("noncongruent_minor_loops", "share", alike=False, share=0.4),
    "creep": _one("creep", "per_decade", per_decade=0.01),
    "gain_drift": _one("gain_drift", "relative_change", relative_change=-0.015),
    "output_nonlinearity": _one("output_nonlinearity", "curvature", curvature=0.02),
    "contact_gap": _one("contact_gap", "gap_N", gap_N=40.0, touch_N=0.5),
    "friction": _one("friction", "force_N", force_N=1.5, presliding_N=15.0),
    "resonance": _one("resonance", "frequency_Hz", frequency_Hz=90.0, damping_ratio=0.1),
    "thermal_drift": _one("thermal_drift", "coefficient_N_per_K", coefficient_N_per_K=1.5),
    "load_step": _one("load_step", "step_N", step_N=5.0, on_s=10.0, off_s=20.0),
    "vibration": _one("vibration", "frequency_Hz", amplitude_N=1.0, frequency_Hz=23.7),
    "charge_leakage": _one("charge_leakage", "time_constant_s", time_constant_s=1500.0),
    "sensor_filter": _one("sensor_filter", "cutoff_Hz", cutoff_Hz=40.0),
    "feedthrough": _one("feedthrough", "coefficient_N_s_per_V", coefficient_N_s_per_V=0.004, bandwidth_Hz=50.0),
    "mains_hum": _one("mains_hum", "amplitude_N", amplitude_N=0.8, frequency_Hz=50.0),
    "sensor_dropout": _one("sensor_dropout", "from_s", places_s=[[5.0, 5.4], [12.0, 13.0]]),
    "quantisation": _one("quantisation", "step_N", step_N=1.0),
    "transport_delay": _one("transport_delay", "delay_s", delay_s=0.007),
    "clock_skew": Switched("clock_skew", {"skew_ppm": 100.0}, "skew_ppm", over_link=False),
}
