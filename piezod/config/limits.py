"""The `limits` section: values that no command may exceed."""

from math import sqrt
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section, require


def _limit(low: float, high: float, acts: str, tighter: int = 0) -> Any:  # noqa: ANN401  # as `pydantic.Field`
    """Bounds of a limit, when it acts, and the direction in which it may change while the bench is armed; 0: none."""
    return Field(ge=low, le=high, json_schema_extra={"acts": acts, "tighter": tighter})


class LimitsConfig(Section):
    """Electrical, thermal, mechanical and timing limits of stack, amplifier and specimen; null: not monitored.

    The bounds of each limit stand here with when it acts, for `piezod config check`. Beyond them it never acts.
    """

    # Amplifiers of piezo stacks give up to 2 kV; a ramp below 0.1 V/s does not end while somebody waits for it.
    voltage_min_V: Annotated[float, _limit(-1e4, 1e4, "in each tick")]
    voltage_max_V: Annotated[float, _limit(-1e4, 1e4, "in each tick", -1)]
    voltage_step_V: Annotated[float, _limit(0.0, 100.0, "in each tick")] = 0.0
    slew_V_per_s: Annotated[float, _limit(0.1, 1e8, "in each tick", -1)]
    slew_down_V_per_s: Annotated[float | None, _limit(0.1, 1e8, "in each tick")] = None
    acceleration_V_per_s2: Annotated[float | None, _limit(0.1, 1e12, "in each tick before a stop or a fault")] = None
    deceleration_V_per_s2: Annotated[float | None, _limit(0.1, 1e12, "in each tick after a stop or a fault")] = None
    resonance_Hz: Annotated[float | None, _limit(0.1, 1e6, "on the slew, when the file is read")] = None
    # A stack has nanofarads to a millifarad; the mean of the heat must see a reversal, and the stack cools in an hour.
    current_max_A: Annotated[float, _limit(1e-6, 1e3, "on the slew, when the file is read")]
    capacitance_F: Annotated[float, _limit(1e-12, 1.0, "on the slew, when the file is read")]
    dissipation_max_W: Annotated[float | None, _limit(1e-9, 1e4, "at the first tick of a mean above", -1)] = None
    loss_tangent: Annotated[float | None, _limit(1e-5, 1.0, "by the heat")] = None
    dissipation_over_s: Annotated[float, _limit(0.1, 3600.0, "by the mean of the heat")] = 10.0
    # The Curie temperature of a stack is below 400 degC; a temperature that rests for a day is no measurement.
    temperature_trip_degC: Annotated[float | None, _limit(-273.15, 400.0, "at the first reading above", -1)] = None
    temperature_low_degC: Annotated[float, _limit(-273.15, 400.0, "after 10 readings below", 1)] = -40.0
    temperature_frozen_s: Annotated[float | None, _limit(0.01, 86400.0, "after this time", -1)] = None
    # The largest stacks block 0.1 MN; a jump takes a microsecond at least.
    force_min_N: Annotated[float, _limit(-1e6, 1e6, "after force_debounce_samples below", 1)]
    force_trip_N: Annotated[float, _limit(-1e6, 1e6, "after force_debounce_samples above", -1)]
    force_debounce_samples: Annotated[int, _limit(1, 100, "by this number of readings", -1)] = 1
    force_rate_trip_N_per_s: Annotated[float | None, _limit(1e-3, 1e12, "after force_debounce_samples", -1)] = None
    tracking_trip_N: Annotated[float | None, _limit(1e-6, 1e6, "after tracking_trip_ms", -1)] = None
    # An operator sees a silence, an error or a clamp within a minute.
    tracking_trip_ms: Annotated[float, _limit(0.01, 6e4, "after this time", -1)] = 100.0
    readback_trip_V: Annotated[float | None, _limit(1e-6, 1e4, "after readback_trip_ms", -1)] = None
    readback_trip_ms: Annotated[float, _limit(0.01, 6e4, "after this time", -1)] = 50.0
    stuck_samples: Annotated[int | None, _limit(2, 1_000_000, "after this number and stuck_travel_V", -1)] = None
    stuck_travel_V: Annotated[float, _limit(1e-6, 1e4, "after this way and stuck_samples")] = 5.0
    ramp_down_V_per_s: Annotated[float, _limit(0.1, 1e8, "in each tick of a ramp down")]
    stale_after_ms: Annotated[float, _limit(0.01, 6e4, "after this time", -1)]
    comm_loss_ms: Annotated[float, _limit(0.01, 6e4, "after this time", -1)]
    comm_loss_action: Literal["ramp_down", "hold", "zero"] = "ramp_down"
    device_watchdog_ms: Annotated[int, _limit(0, 65535, "after this time; 0: never")] = 0
    missed_ticks_in_a_row: Annotated[int, _limit(1, 1_000_000, "after this number", -1)] = 5
    failed_exchanges: Annotated[int | None, _limit(1, 1_000_000, "after this number", -1)] = None
    output_on_in_status: bool = False
    clamped_trip_ms: Annotated[float | None, _limit(0.01, 6e4, "after this time", -1)] = None
    arming_timeout_s: Annotated[float, _limit(0.01, 3600.0, "after this time", -1)] = 10.0

    @property
    def acts_after(self) -> dict[str, str]:
        """Value of each limit and when it acts, in words; a limit of null never acts."""
        acts = {name: _about(name)["acts"] for name in LimitsConfig.model_fields if _about(name)}
        values = {name: getattr(self, name) for name in acts}
        return {name: "null" if values[name] is None else f"{values[name]:g}, acts {acts[name]}" for name in acts}

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


def _about(name: str) -> dict[str, Any]:
    """Texts of `_limit` about a limit; empty for a key that is no number."""
    extra = LimitsConfig.model_fields[name].json_schema_extra
    return dict(extra) if isinstance(extra, dict) else {}


def loosened_limit(old: LimitsConfig, new: LimitsConfig) -> str:
    """Message about the first limit that may not change this way while the bench is armed; empty: all may."""
    for name in LimitsConfig.model_fields:
        before, after = getattr(old, name), getattr(new, name)
        if before == after:
            continue
        if not (direction := _about(name).get("tighter", 0)):
            return f"limits.{name} would change from {before} to {after}"
        # null switches the limit off: the loosest value
        if after is None or (before is not None and (after - before) * direction < 0):
            change = f"from {_limit_text(before)} to {_limit_text(after)}"
            return f"limits.{name} would go {change}, which is looser"
    return ""


def _limit_text(value: float | None) -> str:
    return "null" if value is None else f"{value:g}"
