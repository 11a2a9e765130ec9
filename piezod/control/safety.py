"""The state machine: what the bench may do now, and why.

    DISARMED -> ARMING -> RUNNING <-> HOLD -> RAMP_DOWN -> DISARMED
                                 fault ----> RAMP_DOWN -> FAULT (latched)

DISARMED and FAULT only read. Nothing re-arms by itself. Each fault has a text with its remedy.
"""

from enum import IntEnum

from piezod.config import LimitsConfig


class State(IntEnum):
    """What the loop does this tick."""

    DISARMED = 0
    ARMING = 1
    RUNNING = 2
    HOLD = 3
    RAMP_DOWN = 4
    FAULT = 5


class Cause(IntEnum):
    """Why the last transition happened."""

    NONE = 0
    ARMED = 1
    REFERENCE_REACHED = 2
    STOPPED = 3
    REFERENCE_ENDED = 4
    REFERENCE_STALE = 5
    REFERENCE_LIVE = 6
    COMM_LOSS = 7
    OVER_FORCE = 8
    UNDER_FORCE = 9
    MISSED_TICKS = 10
    DEVICE_FAULT = 11
    DEVICE_WATCHDOG = 12
    SAFE = 13
    RESET = 14


CAUSE_TEXT = {
    Cause.NONE: "started",
    Cause.ARMED: "armed",
    Cause.REFERENCE_REACHED: "first reference reached",
    Cause.STOPPED: "stop requested",
    Cause.REFERENCE_ENDED: "reference ended",
    Cause.REFERENCE_STALE: "reference stale; check who sends it",
    Cause.REFERENCE_LIVE: "reference live again",
    Cause.COMM_LOSS: "no good exchange for limits.comm_loss_ms; check cable, device and timeout_s",
    Cause.OVER_FORCE: "force above limits.force_trip_N; check specimen, reference and load cell",
    Cause.UNDER_FORCE: "force below limits.force_min_N; check preload and load cell",
    Cause.MISSED_TICKS: "too many ticks missed in a row; lower rate_Hz or free the machine (piezod latency)",
    Cause.DEVICE_FAULT: "the amplifier reports a fault; read its display",
    Cause.DEVICE_WATCHDOG: "the device's watchdog tripped; check tick and device_watchdog_ms",
    Cause.SAFE: "safe voltage reached",
    Cause.RESET: "fault reset",
}

STATUS_WATCHDOG = 2
STATUS_FAULTS = 8 | 16 | 32  # amplifier fault, over-temperature, mains lost

_DRIVING = (State.ARMING, State.RUNNING, State.HOLD)


class Supervisor:
    """Owns the state and every reason to change it.

    Parameters
    ----------
    limits
        Force, communication and timing limits.
    """

    def __init__(self, limits: LimitsConfig) -> None:
        self._limits = limits
        self._comm_loss_ns = round(limits.comm_loss_ms * 1e6)
        full_ramp_s = (limits.voltage_max_V - limits.voltage_min_V) / limits.ramp_down_V_per_s
        self._give_up_ns = self._comm_loss_ns + round(full_ramp_s * 1e9)
        self._holds_on_comm_loss = limits.comm_loss_action == "hold"
        self._last_good_ns = 0
        self._fault = Cause.NONE
        self._hasty = False
        self.state = State.DISARMED
        self.cause = Cause.NONE

    @property
    def driving(self) -> bool:
        """Whether voltages are written this tick."""
        return self.state in _DRIVING or self.state is State.RAMP_DOWN

    @property
    def in_haste(self) -> bool:
        """Whether the ramp down goes as fast as the slew limit allows."""
        return self._hasty or (self._fault is Cause.COMM_LOSS and self._limits.comm_loss_action == "zero")

    @property
    def fault(self) -> Cause:
        """The latched fault, or Cause.NONE."""
        return self._fault

    def arm(self, now_ns: int) -> None:
        """DISARMED -> ARMING; from any other state nothing happens."""
        if self.state is State.DISARMED and self._fault is Cause.NONE:
            self._last_good_ns = now_ns
            self._hasty = False
            self._go(State.ARMING, Cause.ARMED)

    def reached(self) -> None:
        """ARMING -> RUNNING: the bench stands at its first reference."""
        if self.state is State.ARMING:
            self._go(State.RUNNING, Cause.REFERENCE_REACHED)

    def stop(self, cause: Cause = Cause.STOPPED, *, hasty: bool = False) -> None:
        """Ramp down and disarm; in haste, as fast as the slew limit allows."""
        self._hasty = self._hasty or hasty
        if self.state in _DRIVING:
            self._go(State.RAMP_DOWN, cause)

    def hold(self, cause: Cause) -> None:
        """RUNNING -> HOLD: keep the voltage."""
        if self.state is State.RUNNING:
            self._go(State.HOLD, cause)

    def resume(self) -> None:
        """HOLD -> RUNNING: a live reference came back."""
        if self.state is State.HOLD:
            self._go(State.RUNNING, Cause.REFERENCE_LIVE)

    def trip(self, cause: Cause) -> None:
        """Latch a fault and ramp down."""
        if self._fault is Cause.NONE and self.driving:
            self._fault = cause
            self._go(State.RAMP_DOWN, cause)

    def safe(self) -> None:
        """RAMP_DOWN -> DISARMED, or FAULT when one is latched."""
        if self.state is State.RAMP_DOWN:
            if self._fault is Cause.NONE:
                self._go(State.DISARMED, Cause.SAFE)
            else:
                self._go(State.FAULT, self._fault)

    def reset(self) -> None:
        """FAULT -> DISARMED, by an operator's word only."""
        if self.state is State.FAULT:
            self._fault = Cause.NONE
            self._go(State.DISARMED, Cause.RESET)

    def judge_exchange(self, good: bool, now_ns: int) -> None:
        """Take note of an exchange; trip on a long silence, then leave the rest to the device's watchdog."""
        if good:
            self._last_good_ns = now_ns
            return
        silent_ns = now_ns - self._last_good_ns
        if silent_ns > self._comm_loss_ns:
            self.trip(Cause.COMM_LOSS)
        if self._fault is Cause.COMM_LOSS and (self._holds_on_comm_loss or silent_ns > self._give_up_ns):
            self.safe()

    def judge_reading(self, force_N: float, status: int) -> None:
        """Trip on a force outside its limits or a device that reports a fault."""
        if force_N > self._limits.force_trip_N:
            self.trip(Cause.OVER_FORCE)
        elif force_N < self._limits.force_min_N:
            self.trip(Cause.UNDER_FORCE)
        elif status & STATUS_FAULTS:
            self.trip(Cause.DEVICE_FAULT)
        elif status & STATUS_WATCHDOG and self.state is not State.ARMING:
            self.trip(Cause.DEVICE_WATCHDOG)

    def judge_clock(self, missed_in_a_row: int) -> None:
        """Trip when the loop cannot hold its rate."""
        if missed_in_a_row >= self._limits.missed_ticks_in_a_row:
            self.trip(Cause.MISSED_TICKS)

    def _go(self, state: State, cause: Cause) -> None:
        self.state = state
        self.cause = cause
