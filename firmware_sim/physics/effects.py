"""The effects of a scenario, by their catalogue names, with their parameters and default strengths.

Every default shows clearly in a record of a bench with 0.1 N of noise.
"""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Span = Annotated[tuple[NotNegative, Positive], Field(strict=False)]


class Section(BaseModel):
    """Section of a configuration: frozen, strict, without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class ElectricalLag(Section):
    """Output resistance into the stack's capacitance."""

    time_constant_s: Positive = 0.008


class SlewLimit(Section):
    """Current limit into the stack's capacitance."""

    limit_V_per_s: Positive = 60.0


class VoltageClamp(Section):
    """Output stage that saturates below its rating."""

    limit_V: Positive = 115.0


class RateDependentHysteresis(Section):
    """Coercive offset `growth` ln(1 + rate / reference), relative to the width scale; it builds up over `path_V`."""

    growth: Positive = 0.03
    reference_V_per_s: Positive = 10.0
    path_V: Positive = 2.0


class NoncongruentMinorLoops(Section):
    """Share of the irreversible weight whose Preisach density depends on the bias."""

    share: Annotated[float, Field(gt=0, le=1)] = 0.4


class Creep(Section):
    """Creep with the logarithm of time between `from_s` and `to_s`, relative to the step."""

    per_decade: Positive = 0.015
    from_s: Positive = 0.1
    to_s: Positive = 1000.0


class GainDrift(Section):
    """Relative change of the sensitivity at `over_s`; it levels off exponentially."""

    relative_change: Finite = -0.03
    over_s: Positive = 60.0


class OutputNonlinearity(Section):
    """Curvature k of the force law, in addition to that of the scenario."""

    curvature: Annotated[float, Field(ge=-1, le=1)] = 0.05


class ContactGap(Section):
    """Gap that the first `gap_N` close before any force arrives; `touch_N` softens the onset."""

    gap_N: Positive = 20.0
    touch_N: Positive = 1.0


class Friction(Section):
    """Dahl friction in the guide; it develops over the travel `presliding_N`, measured in force."""

    force_N: Positive = 3.0
    presliding_N: Positive = 15.0


class Resonance(Section):
    """Second-order mode of stack and load."""

    frequency_Hz: Annotated[float, Field(gt=0, le=3000)] = 45.0
    damping_ratio: Annotated[float, Field(gt=0, le=2)] = 0.05


class ThermalDrift(Section):
    """Force that follows the temperature."""

    coefficient_N_per_K: Finite = 2.0


class LoadStep(Section):
    """Load applied at `on_s` and removed at `off_s` (null: never)."""

    step_N: Finite = 5.0
    on_s: NotNegative = 10.0
    off_s: Positive | None = 20.0
    rise_s: Positive = 0.002


class Vibration(Section):
    """Vibration from a machine nearby; `breathing` is the relative modulation of its amplitude."""

    amplitude_N: Positive = 1.0
    frequency_Hz: Positive = 23.7
    breathing: Annotated[float, Field(ge=0, lt=1)] = 0.1


class ChargeLeakage(Section):
    """Charge amplifier whose charge leaks with a time constant."""

    time_constant_s: Positive = 60.0


class SensorFilter(Section):
    """Low-pass of the load cell amplifier; order 2 is Butterworth."""

    cutoff_Hz: Positive = 15.0
    order: Annotated[int, Field(ge=1, le=2)] = 1


class Feedthrough(Section):
    """Cross-talk of the voltage rate into the signal, limited to `bandwidth_Hz`."""

    coefficient_N_s_per_V: Finite = 0.01
    bandwidth_Hz: Positive = 300.0


class MainsHum(Section):
    """Mains hum with third and fifth harmonic, at a random phase."""

    amplitude_N: Positive = 0.8
    frequency_Hz: Positive = 50.0


class SensorDropout(Section):
    """Spans (from, to) of device time [s] in which the reading is frozen."""

    places_s: Annotated[tuple[Span, ...], Field(max_length=16, strict=False)] = ((5.0, 5.4), (12.0, 13.0))


class Quantisation(Section):
    """Coarse converter step."""

    step_N: Positive = 1.0


class TransportDelay(Section):
    """Pure delay between the load cell and the reading."""

    delay_s: Annotated[float, Field(gt=0, le=0.5)] = 0.0065


class ClockSkew(Section):
    """Rate error of the device clock relative to the clock of the client."""

    skew_ppm: Annotated[float, Field(ge=-20_000, le=20_000)] = 500.0


class Effects(Section):
    """The effects of a scenario; None: off."""

    electrical_lag: ElectricalLag | None = None
    slew_limit: SlewLimit | None = None
    voltage_clamp: VoltageClamp | None = None
    rate_dependent_hysteresis: RateDependentHysteresis | None = None
    noncongruent_minor_loops: NoncongruentMinorLoops | None = None
    creep: Creep | None = None
    gain_drift: GainDrift | None = None
    output_nonlinearity: OutputNonlinearity | None = None
    contact_gap: ContactGap | None = None
    friction: Friction | None = None
    resonance: Resonance | None = None
    thermal_drift: ThermalDrift | None = None
    load_step: LoadStep | None = None
    vibration: Vibration | None = None
    charge_leakage: ChargeLeakage | None = None
    sensor_filter: SensorFilter | None = None
    feedthrough: Feedthrough | None = None
    mains_hum: MainsHum | None = None
    sensor_dropout: SensorDropout | None = None
    quantisation: Quantisation | None = None
    transport_delay: TransportDelay | None = None
    clock_skew: ClockSkew | None = None
