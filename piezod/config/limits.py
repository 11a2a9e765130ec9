"""The `limits` section: what may never be exceeded, whatever is asked."""

from math import sqrt
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section

Positive = Annotated[float, Field(gt=0)]


class LimitsConfig(Section):
    """Electrical, thermal, mechanical and timing limits of stack, amplifier and specimen; null: not watched."""

    voltage_min_V: float
    voltage_max_V: float
    voltage_step_V: Annotated[float, Field(ge=0)] = 0.0
    slew_V_per_s: Positive
    slew_down_V_per_s: Positive | None = None
    acceleration_V_per_s2: Positive | None = None
    resonance_Hz: Positive | None = None
    current_max_A: Positive
    capacitance_F: Positive
    dissipation_max_W: Positive | None = None
    loss_tangent: Annotated[float, Field(gt=0, lt=1)] | None = None
    dissipation_over_s: Positive = 10.0
    temperature_trip_degC: float | None = None
    force_min_N: float
    force_trip_N: float
    force_debounce_samples: Annotated[int, Field(ge=1, le=100)] = 1
    force_rate_trip_N_per_s: Positive | None = None
    tracking_trip_N: Positive | None = None
    tracking_trip_ms: Positive = 100.0
    readback_trip_V: Positive | None = None
    readback_trip_ms: Positive = 50.0
    stuck_samples: Annotated[int, Field(ge=2)] | None = None
    stuck_travel_V: Positive = 5.0
    ramp_down_V_per_s: Positive
    stale_after_ms: Positive
    comm_loss_ms: Positive
    comm_loss_action: Literal["ramp_down", "hold", "zero"] = "ramp_down"
    device_watchdog_ms: Annotated[int, Field(ge=0, le=65535)] = 0
    missed_ticks_in_a_row: Annotated[int, Field(ge=1)] = 5

    @property
    def voltage_safe_V(self) -> float:
        """The voltage a safe state ends at: zero, or the end of the range nearest to it."""
        return min(max(0.0, self.voltage_min_V), self.voltage_max_V)

    @property
    def fall_V_per_s(self) -> float:
        """Fastest fall [V/s]."""
        return self.slew_down_V_per_s or self.slew_V_per_s

    @property
    def full_range_s(self) -> float:
        """Shortest time over the whole voltage range [s], within slew and acceleration."""
        span_V, slew = self.voltage_max_V - self.voltage_min_V, max(self.slew_V_per_s, self.fall_V_per_s)
        acceleration = self.acceleration_V_per_s2
        if acceleration is None:
            return span_V / slew
        if slew**2 > acceleration * span_V:
            return 2.0 * sqrt(span_V / acceleration)
        return span_V / slew + slew / acceleration

    @model_validator(mode="after")
    def _ranges_are_ranges(self) -> Self:
        for low, high, unit in (("voltage_min", "voltage_max", "V"), ("force_min", "force_trip", "N")):
            low_value, high_value = getattr(self, f"{low}_{unit}"), getattr(self, f"{high}_{unit}")
            if low_value >= high_value:
                raise ValueError(f"{low}_{unit} is {low_value:g}, must be below {high}_{unit}, {high_value:g}")
        return self

    @model_validator(mode="after")
    def _amplifier_can_charge_the_stack_so_fast(self) -> Self:
        possible = self.current_max_A / self.capacitance_F
        for name in ("slew_V_per_s", "slew_down_V_per_s", "ramp_down_V_per_s"):
            rate = getattr(self, name)
            if rate is not None and rate > possible * (1 + 1e-9):
                raise ValueError(
                    f"{name} is {rate:g}, must be at most current_max_A / capacitance_F = {possible:g}; lower it"
                )
        if self.ramp_down_V_per_s > self.fall_V_per_s:
            name = "slew_V_per_s" if self.slew_down_V_per_s is None else "slew_down_V_per_s"
            raise ValueError(
                f"ramp_down_V_per_s is {self.ramp_down_V_per_s:g}, must be at most {name}, {self.fall_V_per_s:g}"
            )
        return self

    @model_validator(mode="after")
    def _resonance_is_not_rung(self) -> Self:
        """A move over the range that lasts half a period of the loaded resonance rings it; a longer one less."""
        if self.resonance_Hz is not None and self.full_range_s < 0.5 / self.resonance_Hz:
            raise ValueError(
                f"resonance_Hz is {self.resonance_Hz:g}, but the range can be crossed in {1e3 * self.full_range_s:.3g} "
                f"ms, must be at least half a period, {500.0 / self.resonance_Hz:.3g} ms; lower slew_V_per_s or "
                "acceleration_V_per_s2"
            )
        return self

    @model_validator(mode="after")
    def _heat_can_be_reckoned(self) -> Self:
        if (self.dissipation_max_W is None) != (self.loss_tangent is None):
            missing = "loss_tangent" if self.loss_tangent is None else "dissipation_max_W"
            raise ValueError(f"{missing} is missing: dissipation_max_W and loss_tangent are given both or not at all")
        return self

    @model_validator(mode="after")
    def _times_are_in_order(self) -> Self:
        if self.stale_after_ms > self.comm_loss_ms:
            raise ValueError(
                f"stale_after_ms is {self.stale_after_ms:g}, must be at most comm_loss_ms, {self.comm_loss_ms:g}"
            )
        if self.device_watchdog_ms >= self.comm_loss_ms:
            raise ValueError(
                f"device_watchdog_ms is {self.device_watchdog_ms}, must be below comm_loss_ms, {self.comm_loss_ms:g}"
            )
        return self


# Which way a limit may be moved while the bench is armed: +1 up, -1 down. Every other one stays as it is.
_TIGHTER = {
    "voltage_max_V": -1,
    "slew_V_per_s": -1,
    "dissipation_max_W": -1,
    "temperature_trip_degC": -1,
    "force_min_N": 1,
    "force_trip_N": -1,
    "force_debounce_samples": -1,
    "force_rate_trip_N_per_s": -1,
    "tracking_trip_N": -1,
    "tracking_trip_ms": -1,
    "readback_trip_V": -1,
    "readback_trip_ms": -1,
    "stuck_samples": -1,
    "stale_after_ms": -1,
    "comm_loss_ms": -1,
    "missed_ticks_in_a_row": -1,
}


def loosened(old: LimitsConfig, new: LimitsConfig) -> str:
    """Name the first limit that `new` loosens, or changes in a way that an armed bench cannot take; empty: none.

    Parameters
    ----------
    old
        In force.
    new
        To be in force.
    """
    for name in LimitsConfig.model_fields:
        before, after = getattr(old, name), getattr(new, name)
        if before == after:
            continue
        way = _TIGHTER.get(name)
        if way is None:
            return f"limits.{name} would change from {before} to {after}; only when disarmed"
        # null is the loosest of all
        if after is None or (before is not None and (after - before) * way < 0):
            return f"limits.{name} would go from {_told(before)} to {_told(after)}, which is looser; disarm first"
    return ""


def _told(value: float | None) -> str:
    return "null" if value is None else f"{value:g}"
