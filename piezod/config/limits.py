"""The `limits` section: values that no command may exceed."""

from math import sqrt
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Positive, Section, require


class LimitsConfig(Section):
    """Electrical, thermal, mechanical and timing limits of stack, amplifier and specimen; null: not monitored."""

    voltage_min_V: float
    voltage_max_V: float
    voltage_step_V: Annotated[float, Field(ge=0)] = 0.0
    slew_V_per_s: Positive
    slew_down_V_per_s: Positive | None = None
    acceleration_V_per_s2: Positive | None = None
    deceleration_V_per_s2: Positive | None = None
    resonance_Hz: Positive | None = None
    current_max_A: Positive
    capacitance_F: Positive
    dissipation_max_W: Positive | None = None
    loss_tangent: Annotated[float, Field(gt=0, lt=1)] | None = None
    dissipation_over_s: Positive = 10.0
    temperature_trip_degC: float | None = None
    temperature_low_degC: float = -40.0
    temperature_frozen_s: Positive | None = None
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
    failed_exchanges: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    output_on_in_status: bool = False
    clamped_trip_ms: Positive | None = None
    arming_timeout_s: Annotated[float, Field(gt=0, le=3600)] = 10.0

    @property
    def voltage_safe_V(self) -> float:
        """Final voltage of the safe state [V]: zero, or the end of the range nearest to zero."""
        return min(max(0.0, self.voltage_min_V), self.voltage_max_V)

    @property
    def summary(self) -> str:
        """Voltage, slew and force limits in a line."""
        return (
            f"{self.voltage_min_V:g} to {self.voltage_max_V:g} V, {self.slew_V_per_s:g} V/s, "
            f"{self.force_min_N:g} to {self.force_trip_N:g} N"
        )

    @property
    def fall_V_per_s(self) -> float:
        """Highest rate of a falling voltage [V/s]."""
        return self.slew_down_V_per_s or self.slew_V_per_s

    @property
    def braking_s(self) -> float:
        """Longest time until a rising voltage turns after a stop or a fault [s]."""
        return self.slew_V_per_s / self.deceleration_V_per_s2 if self.deceleration_V_per_s2 else 0.0

    @property
    def full_range_s(self) -> float:
        """Shortest time for the whole voltage range [s] at the given slew and acceleration."""
        span_V, slew = self.voltage_max_V - self.voltage_min_V, max(self.slew_V_per_s, self.fall_V_per_s)
        acceleration = self.acceleration_V_per_s2
        if acceleration is None:
            return span_V / slew
        if slew**2 > acceleration * span_V:
            return 2.0 * sqrt(span_V / acceleration)
        return span_V / slew + slew / acceleration

    @model_validator(mode="after")
    def _low_ends_lie_below_high_ends(self) -> Self:
        for low, high in (("voltage_min_V", "voltage_max_V"), ("force_min_N", "force_trip_N")):
            low_value, high_value = getattr(self, low), getattr(self, high)
            require(low_value < high_value, low, low_value, f"below {high}, {high_value:g}")
        return self

    @model_validator(mode="after")
    def _the_amplifier_current_allows_the_slew(self) -> Self:
        possible = self.current_max_A / self.capacitance_F
        for name in ("slew_V_per_s", "slew_down_V_per_s", "ramp_down_V_per_s"):
            rate = getattr(self, name)
            if rate is not None:
                limit = f"at most current_max_A / capacitance_F = {possible:g}; lower it"
                require(rate <= possible * (1 + 1e-9), name, rate, limit)
        down = "slew_V_per_s" if self.slew_down_V_per_s is None else "slew_down_V_per_s"
        limit = f"at most {down}, {self.fall_V_per_s:g}"
        require(self.ramp_down_V_per_s <= self.fall_V_per_s, "ramp_down_V_per_s", self.ramp_down_V_per_s, limit)
        return self

    @model_validator(mode="after")
    def _a_stop_is_not_gentler_than_the_reference(self) -> Self:
        least, own = self.acceleration_V_per_s2, self.deceleration_V_per_s2
        if least is not None and own is not None:
            require(own >= least, "deceleration_V_per_s2", own, f"at least acceleration_V_per_s2, {least:g}")
        return self

    @model_validator(mode="after")
    def _the_slew_does_not_excite_the_resonance(self) -> Self:
        """Require at least half a period of the loaded resonance for a move over the whole range."""
        if self.resonance_Hz is not None and self.full_range_s < 0.5 / self.resonance_Hz:
            raise ValueError(
                f"resonance_Hz is {self.resonance_Hz:g}, but the range can be crossed in {1e3 * self.full_range_s:.3g} "
                f"ms, must be at least half a period, {500.0 / self.resonance_Hz:.3g} ms; lower slew_V_per_s or "
                "acceleration_V_per_s2"
            )
        return self

    @model_validator(mode="after")
    def _dissipation_has_both_keys(self) -> Self:
        if (self.dissipation_max_W is None) != (self.loss_tangent is None):
            missing = "loss_tangent" if self.loss_tangent is None else "dissipation_max_W"
            raise ValueError(f"{missing} is missing: give both dissipation_max_W and loss_tangent, or neither")
        return self

    @model_validator(mode="after")
    def _times_are_in_order(self) -> Self:
        loss = f"comm_loss_ms, {self.comm_loss_ms:g}"
        require(self.stale_after_ms <= self.comm_loss_ms, "stale_after_ms", self.stale_after_ms, f"at most {loss}")
        watchdog_ms = self.device_watchdog_ms
        require(watchdog_ms < self.comm_loss_ms, "device_watchdog_ms", watchdog_ms, f"below {loss}")
        return self


# Limits that may change while the bench is armed, upwards or downwards. All other limits must not change.
_TIGHTER_UP = ("force_min_N", "temperature_low_degC")
_TIGHTER_DOWN = (
    *("voltage_max_V", "slew_V_per_s", "dissipation_max_W", "temperature_trip_degC", "temperature_frozen_s"),
    *("force_trip_N", "force_debounce_samples", "force_rate_trip_N_per_s", "tracking_trip_N", "tracking_trip_ms"),
    *("readback_trip_V", "readback_trip_ms", "stuck_samples", "stale_after_ms", "comm_loss_ms"),
    *("missed_ticks_in_a_row", "failed_exchanges", "clamped_trip_ms", "arming_timeout_s"),
)


def loosened_limit(old: LimitsConfig, new: LimitsConfig) -> str:
    """Message about the first limit that may not change this way while the bench is armed; empty: all may."""
    for name in LimitsConfig.model_fields:
        before, after = getattr(old, name), getattr(new, name)
        if before == after:
            continue
        if name not in (*_TIGHTER_UP, *_TIGHTER_DOWN):
            return f"limits.{name} would change from {before} to {after}"
        # null switches the limit off: the loosest value
        if after is None or (before is not None and (after < before) == (name in _TIGHTER_UP)):
            change = f"from {_limit_text(before)} to {_limit_text(after)}"
            return f"limits.{name} would go {change}, which is looser"
    return ""


def _limit_text(value: float | None) -> str:
    return "null" if value is None else f"{value:g}"
