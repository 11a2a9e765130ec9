"""The effects that can be switched on in a scenario, by the names of the catalogue; each with defaults one can see.

A default is a strength that shows clearly on a working record of a bench with 0.1 N of noise.
"""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Stretch = Annotated[tuple[NotNegative, Positive], Field(strict=False)]


class Section(BaseModel):
    """A part of a configuration: frozen, strict, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class ElectricalLag(Section):
    """Output resistance into the stack's capacitance."""

    time_constant_s: Positive = 0.008


class SlewLimit(Section):
    """Current limit into the stack's capacitance."""

    limit_V_per_s: Positive = 60.0


class VoltageClamp(Section):
    """The output stage saturates below its rating."""

    limit_V: Positive = 115.0


class RateDependentHysteresis(Section):
    """Coercive offset, in parts of the density's width scale, that grows with ln(1 + rate / reference)."""

    growth: Positive = 0.03
    reference_V_per_s: Positive = 10.0
    path_V: Positive = 2.0


class NoncongruentMinorLoops(Section):
    """Part of the irreversible weight whose density depends on the bias."""

    share: Annotated[float, Field(gt=0, le=1)] = 0.4


class Creep(Section):
    """Creep with the logarithm of time, relative to the step, between two times."""

    per_decade: Positive = 0.015
    from_s: Positive = 0.1
    to_s: Positive = 1000.0


class GainDrift(Section):
    """Sensitivity that changes by `relative_change` within `over_s` and levels off."""

    relative_change: Finite = -0.03
    over_s: Positive = 60.0


class OutputNonlinearity(Section):
    """Curvature k of the force law beyond the scenario's own."""

    curvature: Annotated[float, Field(ge=-1, le=1)] = 0.05


class ContactGap(Section):
    """Force that only closes a gap before anything arrives; `touch_N` softens the onset."""

    gap_N: Positive = 20.0
    touch_N: Positive = 1.0


class Friction(Section):
    """Dahl friction in the guide; `presliding_N` is the travel, in force, in which it develops."""

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
    """A load that is put on, and taken off again unless `off_s` is null."""

    step_N: Finite = 5.0
    on_s: NotNegative = 10.0
    off_s: Positive | None = 20.0
    rise_s: Positive = 0.002


class Vibration(Section):
    """A machine nearby; its amplitude breathes."""

    amplitude_N: Positive = 1.0
    frequency_Hz: Positive = 23.7
    breathing: Annotated[float, Field(ge=0, lt=1)] = 0.1


class ChargeLeakage(Section):
    """A charge amplifier that forgets its mean."""

    time_constant_s: Positive = 60.0


class SensorFilter(Section):
    """Low-pass of the load cell's amplifier; order 2 is Butterworth."""

    cutoff_Hz: Positive = 15.0
    order: Annotated[int, Field(ge=1, le=2)] = 1


class Feedthrough(Section):
    """The drive couples into the signal; band-limited as the input stage is."""

    coefficient_N_s_per_V: Finite = 0.01
    bandwidth_Hz: Positive = 300.0


class MainsHum(Section):
    """Mains and its third and fifth harmonic, in phase with nothing of ours."""

    amplitude_N: Positive = 0.8
    frequency_Hz: Positive = 50.0


class SensorDropout(Section):
    """Stretches, in device time, in which the reading freezes."""

    places_s: Annotated[tuple[Stretch, ...], Field(max_length=16, strict=False)] = ((5.0, 5.4), (12.0, 13.0))


class Quantisation(Section):
    """A coarse converter."""

    step_N: Positive = 1.0


class TransportDelay(Section):
    """Pure delay between the load cell and the reading."""

    delay_s: Annotated[float, Field(gt=0, le=0.5)] = 0.0065


class ClockSkew(Section):
    """The device's clock against the client's."""

    skew_ppm: Annotated[float, Field(ge=-20_000, le=20_000)] = 500.0


class Effects(Section):
    """Which effects are on; None is off."""

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
