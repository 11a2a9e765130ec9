"""The `limits` section: what may never be exceeded, whatever is asked."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section

Positive = Annotated[float, Field(gt=0)]


class LimitsConfig(Section):
    """Electrical and mechanical limits of stack, amplifier and specimen."""

    voltage_min_V: float
    voltage_max_V: float
    voltage_step_V: Annotated[float, Field(ge=0)] = 0.0
    slew_V_per_s: Positive
    current_max_A: Positive
    capacitance_F: Positive
    force_min_N: float
    force_trip_N: float
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

    @model_validator(mode="after")
    def _limits_agree(self) -> Self:
        if self.voltage_min_V >= self.voltage_max_V:
            raise ValueError(
                f"voltage_min_V is {self.voltage_min_V:g}, must be below voltage_max_V, {self.voltage_max_V:g}"
            )
        if self.force_min_N >= self.force_trip_N:
            raise ValueError(f"force_min_N is {self.force_min_N:g}, must be below force_trip_N, {self.force_trip_N:g}")
        slew_possible = self.current_max_A / self.capacitance_F
        fastest = max(self.slew_V_per_s, self.ramp_down_V_per_s)
        if fastest > slew_possible * (1 + 1e-9):
            name = "slew_V_per_s" if self.slew_V_per_s >= self.ramp_down_V_per_s else "ramp_down_V_per_s"
            raise ValueError(
                f"{name} is {fastest:g}, must be at most current_max_A / capacitance_F = {slew_possible:g}"
            )
        if self.stale_after_ms > self.comm_loss_ms:
            raise ValueError(
                f"stale_after_ms is {self.stale_after_ms:g}, must be at most comm_loss_ms, {self.comm_loss_ms:g}"
            )
        if self.device_watchdog_ms >= self.comm_loss_ms:
            raise ValueError(
                f"device_watchdog_ms is {self.device_watchdog_ms}, must be below comm_loss_ms, {self.comm_loss_ms:g}"
            )
        return self
