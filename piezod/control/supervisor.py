"""The state machine: what the bench may do now, and why.

    DISARMED -> ARMING -> RUNNING <-> HOLD -> RAMP_DOWN -> DISARMED
                                 fault ----> RAMP_DOWN -> FAULT (latched)

DISARMED and FAULT only read. Nothing re-arms by itself. A fault after which the device drives its output by itself (its
watchdog, a restart) goes straight to FAULT: whatever were written then would be a jump.
"""

from math import inf, nan

from piezod.config import LimitsConfig
from piezod.control.interlocks import (
    STATUS_FAULTS,
    STATUS_MAINS_LOST,
    STATUS_OVER_TEMPERATURE,
    STATUS_WATCHDOG,
    ForceInterlock,
    HeatInterlock,
    ReadbackInterlock,
    StuckInterlock,
    TrackingInterlock,
)
from piezod.control.states import CAUSE_TEXT, DEVICE_HAS_TAKEN_OVER, Cause, State
from piezod.transport import Reading

__all__ = ["CAUSE_TEXT", "Cause", "State", "Supervisor"]

_DRIVING = (State.ARMING, State.RUNNING, State.HOLD)
_OF_THE_AMPLIFIER = (Cause.DEVICE_FAULT, Cause.DEVICE_TOO_HOT, Cause.MAINS_LOST)


class Supervisor:
    """Owns the state and every reason to change it.

    Parameters
    ----------
    limits
        Force, communication and timing limits.
    dt_s
        Tick period [s].

    Attributes
    ----------
    blind
        Readings are stale: the voltage stays where it is.
    state, cause
        What the bench does, and why since.
    """

    def __init__(self, limits: LimitsConfig, dt_s: float = 1e-3) -> None:
        self._dt_s = dt_s
        self._last_good_ns = 0
        self._bad_in_a_row = 0
        self._fault = Cause.NONE
        self._hasty = False
        self._watchdog_calm = False
        self.blind = False
        self.state = State.DISARMED
        self.cause = Cause.NONE
        self.take_limits(limits)

    def take_limits(self, limits: LimitsConfig) -> None:
        """Judge by these from now on; state and latched fault stay."""
        self._limits = limits
        self._stale_ns = round(limits.stale_after_ms * 1e6)
        self._comm_loss_ns = round(limits.comm_loss_ms * 1e6)
        full_ramp_s = (limits.voltage_max_V - limits.voltage_min_V) / limits.ramp_down_V_per_s
        self._give_up_ns = self._comm_loss_ns + round(full_ramp_s * 1e9)
        self._holds_on_comm_loss = limits.comm_loss_action == "hold"
        self._watchdog_ns = round(limits.device_watchdog_ms * 1e6)
        self._force = ForceInterlock(limits)
        self._stuck = StuckInterlock(limits)
        self._readback = ReadbackInterlock(limits)
        self._tracking = TrackingInterlock(limits)
        self._heat = HeatInterlock(limits, self._dt_s)

    @property
    def driving(self) -> bool:
        """Whether voltages are written this tick."""
        return self.state in _DRIVING or self.state is State.RAMP_DOWN

    @property
    def in_haste(self) -> bool:
        """Whether the ramp down goes as fast as the slew limit allows."""
        if self._hasty or self._fault in _OF_THE_AMPLIFIER:
            return True
        return self._fault is Cause.COMM_LOSS and self._limits.comm_loss_action == "zero"

    @property
    def suspicious(self) -> bool:
        """Whether the last force was outside a limit, and the next one decides."""
        return self._force.suspicious

    @property
    def spikes(self) -> int:
        """Forces outside a limit that the next sample did not confirm."""
        return self._force.spikes

    @property
    def dissipation_W(self) -> float:
        """Mean power that the stack turns into heat [W]."""
        return self._heat.power_W

    def patience_s(self, now_ns: int) -> float:
        """How long an exchange may last that begins now [s]: silence is judged when it has lasted `comm_loss_ms`."""
        left_ns = self._last_good_ns + self._comm_loss_ns - now_ns
        return 1e-9 * left_ns if left_ns > 0 and self.driving else inf

    @property
    def fault(self) -> Cause:
        """The latched fault, or Cause.NONE."""
        return self._fault

    def arm(self, now_ns: int) -> None:
        """DISARMED -> ARMING; from any other state nothing happens."""
        if self.state is State.DISARMED and self._fault is Cause.NONE:
            self._last_good_ns = now_ns
            self._bad_in_a_row = 0
            self._hasty = self.blind = False
            self._watchdog_calm = False  # one that tripped before is calmed by our first command
            for interlock in (self._force, self._stuck, self._readback, self._tracking):
                interlock.begin()
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

    def bring_down(self, now_ns: int) -> None:
        """DISARMED -> RAMP_DOWN: a voltage was found that nobody drives any more."""
        if self.state is State.DISARMED:
            self._last_good_ns = now_ns
            self._go(State.RAMP_DOWN, Cause.STOPPED)

    def hold(self, cause: Cause) -> None:
        """RUNNING -> HOLD: keep the voltage."""
        if self.state is State.RUNNING:
            self._go(State.HOLD, cause)

    def resume(self) -> None:
        """HOLD -> RUNNING: a live reference came back."""
        if self.state is State.HOLD and not self.blind:
            self._go(State.RUNNING, Cause.REFERENCE_LIVE)

    def trip(self, cause: Cause) -> None:
        """Latch a fault and ramp down, or leave the output to a device that has taken over."""
        if self.driving and self._fault is Cause.NONE:
            self._fault = cause
            self._go(State.RAMP_DOWN, cause)
        if cause in DEVICE_HAS_TAKEN_OVER:
            self.safe()

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

    def judge_gap(self, gap_ns: int) -> None:
        """Before anything is written: trip when this process stood still for longer than the device, or we, wait."""
        if self._watchdog_ns and gap_ns >= self._watchdog_ns:
            self.trip(Cause.STOOD_STILL)
            self.safe()
        elif gap_ns > self._comm_loss_ns:
            self.trip(Cause.STOOD_STILL)

    def judge_exchange(self, good: bool, now_ns: int, *, answered: bool = False, ahead_ns: int = 0) -> None:
        """Take note of an exchange: blind when readings are stale, trip on a long silence or on unbelievable values.

        Parameters
        ----------
        good
            Its reading is believed.
        now_ns
            When it ended, monotonic [ns].
        answered
            The device took the voltage, but its reading cannot be believed.
        ahead_ns
            Silence counts that is longer than `comm_loss_ms` after so much time more: half a tick for a loop that
            judges once a tick, so that it trips at the tick that is nearest.
        """
        if good:
            self._last_good_ns = now_ns
            self._bad_in_a_row = 0
            self.blind = False
            return
        silent_ns = now_ns - self._last_good_ns
        self._bad_in_a_row += 1
        if silent_ns > self._stale_ns:
            if answered and self._bad_in_a_row > 1:
                self.trip(Cause.BAD_READING)
            else:
                self.blind = True
        if silent_ns + ahead_ns > self._comm_loss_ns:
            self.trip(Cause.COMM_LOSS)
        holds = self._holds_on_comm_loss and self._fault is Cause.COMM_LOSS
        if self._fault is not Cause.NONE and (holds or silent_ns > self._give_up_ns):
            self.safe()

    def judge_reading(self, force_N: float, status: int, now_ns: int = 0, temperature_C: float = nan) -> None:
        """Trip on a force outside its limits, a device that reports a fault, or one that is too hot."""
        cause = self._force.judge(force_N, now_ns)
        self._watchdog_calm = self._watchdog_calm or not status & STATUS_WATCHDOG
        if cause is not Cause.NONE:
            self.trip(cause)
        elif status & STATUS_FAULTS:
            self.trip(_named(status))
        elif status & STATUS_WATCHDOG and (self._watchdog_calm or self.state is not State.ARMING):
            self.trip(Cause.DEVICE_WATCHDOG)
        elif self._limits.temperature_trip_degC is not None and temperature_C > self._limits.temperature_trip_degC:
            self.trip(Cause.TEMPERATURE)

    def judge_drive(self, reading: Reading, written_V: float, reference_N: float, now_ns: int) -> None:
        """Trip when what is read does not follow what is written.

        Parameters
        ----------
        reading
            A good one.
        written_V
            The voltage in force since this exchange [V].
        reference_N
            Its reference, if the voltage was written as planned and is one for a force; else nan.
        now_ns
            When the exchange ended, monotonic [ns].
        """
        cause = (
            self._stuck.judge(reading.force_N, reading.heartbeat, written_V)
            or self._readback.judge(reading.voltage_readback_V, written_V, now_ns)
            or self._tracking.judge(reading.force_N, reference_N, now_ns)
            or self._heat.judge(written_V)
        )
        if cause:
            self.trip(cause)

    def judge_clock(self, missed_in_a_row: int) -> None:
        """Trip when the loop cannot hold its rate."""
        if missed_in_a_row >= self._limits.missed_ticks_in_a_row:
            self.trip(Cause.MISSED_TICKS)

    def _go(self, state: State, cause: Cause) -> None:
        self.state = state
        self.cause = cause


def _named(status: int) -> Cause:
    """The cause behind a status that reports a fault: mains before heat before anything else."""
    if status & STATUS_MAINS_LOST:
        return Cause.MAINS_LOST
    return Cause.DEVICE_TOO_HOT if status & STATUS_OVER_TEMPERATURE else Cause.DEVICE_FAULT
