"""The supervisor: every reason to change the state of the control loop (`states.py: TRANSITIONS`).

A device that drives its output by itself (its watchdog tripped, it restarted) leads straight to FAULT: a voltage
written then would be a jump.
"""

from math import ceil, inf, nan

from piezod.config import LimitsConfig
from piezod.control.authority import Demand
from piezod.control.heat_interlock import HeatInterlock
from piezod.control.interlocks import (
    DeviceInterlock,
    ForceInterlock,
    ReadbackInterlock,
    StuckInterlock,
    TemperatureInterlock,
    TrackingInterlock,
)
from piezod.control.leaky_count import WRONG, CountedInterlock, LeakyCount, cells_of
from piezod.control.states import (
    CAUSE_TEXT,
    DANGERS,
    DEVICE_HAS_TAKEN_OVER,
    DRIVING,
    TRANSITIONS,
    Cause,
    Event,
    State,
)
from piezod.errors import CheckFailedError
from piezod.transport import Reading
from piezod.transport.status import STATUS_FAULTS, STATUS_MAINS_LOST, STATUS_OVER_TEMPERATURE, STATUS_WATCHDOG

__all__ = ["CAUSE_TEXT", "Cause", "State", "Supervisor"]

SILENCES = 5.0  # failed exchanges that trip where no number is set, as multiple of those of a silence of `comm_loss_ms`


class Supervisor:
    """State machine of the control loop.

    Parameters
    ----------
    limits
        Limits of force, communication and timing.
    dt_s
        Tick period [s].

    Attributes
    ----------
    force
        Interlock of the force.
    amplifier_tripped
        True when the amplifier has reported a fault since the last arming: its output may be off.
    readings_stale
        True when the last good reading is older than `stale_after_ms`. The loop then keeps the voltage.
    cause
        Cause of the last transition.
    fault
        Latched fault; `Cause.NONE` without a fault.
    """

    def __init__(self, limits: LimitsConfig, dt_s: float = 1e-3) -> None:
        self._last_good_ns = self._armed_ns = self._planned_ns = 0
        self._bad_in_a_row = 0
        self.fault = Cause.NONE
        self._fast_stop = False
        self._watchdog_of_before = False
        self.readings_stale = self.amplifier_tripped = False
        self.state = State.DISARMED
        self.cause = Cause.NONE
        self.force = ForceInterlock(limits)
        self._stuck = StuckInterlock(limits)
        self._readback = ReadbackInterlock(limits)
        self._tracking = TrackingInterlock(limits)
        self._device = DeviceInterlock(limits)
        self._temperature = TemperatureInterlock(limits)
        self._missed, self._failed = LeakyCount(), LeakyCount()
        self._cleared = self.force, self._stuck, self._readback, self._tracking, self._device, self._temperature
        self._heat = HeatInterlock(limits, dt_s)
        self._dt_s = dt_s
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; state, latched fault and everything that the interlocks have summed up stay."""
        self._limits = limits
        self._stale_ns = round(limits.stale_after_ms * 1e6)
        self._comm_loss_ns = round(limits.comm_loss_ms * 1e6)
        full_ramp_s = (limits.voltage_max_V - limits.voltage_min_V) / limits.ramp_down_V_per_s + 2.0 * limits.braking_s
        self._give_up_ns = self._comm_loss_ns + round(full_ramp_s * 1e9)
        self._arming_timeout_ns = round(limits.arming_timeout_s * 1e9)
        self._dangers = DANGERS | {Cause.COMM_LOSS} if limits.comm_loss_action == "zero" else DANGERS
        self._holds_on_comm_loss = limits.comm_loss_action == "hold"
        self._watchdog_ns = round(limits.device_watchdog_ms * 1e6)
        self._most_missed = limits.missed_ticks_in_a_row
        in_silence = ceil(1e-3 * SILENCES * limits.comm_loss_ms / self._dt_s)
        self._failed.trips_at = WRONG * (limits.failed_exchanges or in_silence)
        self._missed.trips_at = WRONG * self._most_missed
        for interlock in (*self._cleared, self._heat):
            interlock.set_limits(limits)

    def show_counts(self, counters: "memoryview[int]") -> None:
        """Keep the leaky counts of the interlocks in counters from now on.

        Parameters
        ----------
        counters
            Counters of the ring log.
        """
        counts = {
            CountedInterlock.FORCE: self.force.count,
            CountedInterlock.READBACK: self._readback.count,
            CountedInterlock.TRACKING: self._tracking.count,
            CountedInterlock.OUTPUT: self._device.count,
            CountedInterlock.THERMOMETER: self._temperature.count,
            CountedInterlock.EXCHANGES: self._failed,
            CountedInterlock.MISSED_TICKS: self._missed,
        }
        for interlock, count in counts.items():
            count.show_in(cells_of(counters, interlock))

    @property
    def heat_W(self) -> float:
        """Mean power that the stack turns into heat [W]; set it to continue the sum of an earlier control process."""
        return self._heat.power_W

    @heat_W.setter
    def heat_W(self, power_W: float) -> None:
        self._heat.power_W = power_W

    @property
    def driving(self) -> bool:
        """Whether voltages are written in this tick."""
        return self.state in DRIVING

    @property
    def demand(self) -> Demand:
        """Demand with the most authority in this tick."""
        if self.state is State.RAMP_DOWN:
            if self._fast_stop:
                return Demand.STOP
            if self.amplifier_tripped or self.fault in self._dangers:
                return Demand.DANGER
            if self.fault is not Cause.NONE:
                return Demand.FAULT
            return Demand.SUSPECT if self.force.suspect else Demand.DISARM
        return Demand.SUSPECT if self.force.suspect else Demand.REFERENCE

    @property
    def spikes(self) -> int:
        """Number of forces outside a limit that the next sample did not confirm."""
        return self.force.spikes

    def exchange_time_left_s(self, now_ns: int) -> float:
        """Longest duration of an exchange that begins now [s]; infinite when no voltage is written.

        An exchange that lasts longer is a communication loss: the silence then exceeds `comm_loss_ms`.
        """
        left_ns = self._last_good_ns + self._comm_loss_ns - now_ns
        return 1e-9 * left_ns if left_ns > 0 and self.driving else inf

    def arm(self, now_ns: int, planned_ns: int = 0) -> None:
        """DISARMED -> ARMING.

        Parameters
        ----------
        now_ns
            Monotonic time [ns].
        planned_ns
            Planned duration of ARMING [ns]; `limits.arming_timeout_s` counts after it.
        """
        self.apply(Event.ARM, Cause.ARMED)
        self._last_good_ns = self._armed_ns = now_ns
        self._planned_ns = planned_ns
        self._bad_in_a_row = 0
        self._fast_stop = self.readings_stale = self.amplifier_tripped = False
        self._watchdog_of_before = True  # it may have tripped earlier; the first command clears it
        for count in (self._missed, self._failed):
            count.clear()
        for interlock in self._cleared:
            interlock.clear()

    def start_running(self) -> None:
        """ARMING -> RUNNING: the output has reached the first reference."""
        self.apply(Event.REACHED, Cause.REFERENCE_REACHED)
        self._watchdog_of_before = False

    def stop(self, cause: Cause = Cause.STOPPED, *, fast: bool = False) -> None:
        """Ramp down and disarm.

        Parameters
        ----------
        fast
            Ramp down as fast as the slew limit allows.
        """
        self._fast_stop = self._fast_stop or fast
        self.apply(Event.STOP, cause)

    def bring_down(self, now_ns: int) -> None:
        """DISARMED or FAULT -> RAMP_DOWN at the monotonic time `now_ns` [ns], for an output that nobody drives.

        A latched fault stays latched.
        """
        self.apply(Event.LEFT, Cause.STOPPED)
        self._last_good_ns = now_ns
        self._bad_in_a_row = 0
        self._watchdog_of_before = False

    def trip(self, cause: Cause) -> None:
        """Latch the fault `cause` and ramp down; end at once when the device has taken over its output."""
        first = self.driving and self.fault is Cause.NONE
        self.apply(Event.TRIP, cause)
        if first:
            self.fault = self.cause = cause
        if cause in DEVICE_HAS_TAKEN_OVER and self.driving:
            self.end_ramp_down()

    def end_ramp_down(self) -> None:
        """RAMP_DOWN -> DISARMED, or -> FAULT when a fault is latched."""
        if self.fault is Cause.NONE:
            self.apply(Event.AT_REST, Cause.SAFE)
        else:
            self.apply(Event.LATCHED, self.fault)

    def reset(self, *, at_rest: bool) -> None:
        """FAULT -> DISARMED; only a command of an operator calls it. No effect off rest.

        Parameters
        ----------
        at_rest
            Whether the output is at the safe voltage.
        """
        if at_rest:
            self.apply(Event.RESET, Cause.RESET)
            self.fault = Cause.NONE

    def check_pause(self, pause_ns: int) -> None:
        """Trip when this process has paused too long; call it before a voltage is written.

        After a pause as long as the device watchdog, the device has taken over: the ramp down ends at once.

        Parameters
        ----------
        pause_ns
            Time without a step of the loop [ns].
        """
        if self._watchdog_ns and pause_ns >= self._watchdog_ns:
            self.trip(Cause.STOOD_STILL)
            if self.driving:
                self.end_ramp_down()
        elif pause_ns > self._comm_loss_ns:
            self.trip(Cause.STOOD_STILL)

    def check_arming(self, now_ns: int) -> None:
        """Ramp down when ARMING lasts too long: a voltage must not stay on while nobody sends a reference.

        Parameters
        ----------
        now_ns
            Monotonic time [ns].
        """
        if self.state is State.ARMING and now_ns - self._armed_ns > self._planned_ns + self._arming_timeout_ns:
            self.stop(Cause.ARMING_TIMEOUT)

    def check_exchange(self, good: bool, now_ns: int, *, answered: bool = False, ahead_ns: int = 0) -> None:
        """Evaluate an exchange: mark stale readings; trip on a long silence or on invalid readings.

        Parameters
        ----------
        good
            Whether its reading is valid.
        now_ns
            Monotonic time of its end [ns].
        answered
            Whether the device took the voltage, even if its reading is invalid.
        ahead_ns
            Time added to the silence before it is compared with `comm_loss_ms` [ns]. The loop checks once a tick and
            adds half a tick, so that it trips at the nearest tick.
        """
        if good:
            self._last_good_ns = now_ns
            self._bad_in_a_row = 0
            self.readings_stale = False
            if self._failed.level:
                self._failed.leak()
            return
        if self.driving and self._failed.add():
            self.trip(Cause.BAD_EXCHANGES)
        silent_ns = now_ns - self._last_good_ns
        self._bad_in_a_row += 1
        if silent_ns > self._stale_ns:
            if answered and self._bad_in_a_row > 1:
                self.trip(Cause.BAD_READING)
            else:
                self.readings_stale = True
        if silent_ns + ahead_ns > self._comm_loss_ns:
            self.trip(Cause.COMM_LOSS)
        holds = self._holds_on_comm_loss and self.fault is Cause.COMM_LOSS
        if self.driving and self.fault is not Cause.NONE and (holds or silent_ns > self._give_up_ns):
            self.end_ramp_down()

    def check_reading(self, force_N: float, status: int, now_ns: int = 0, temperature_C: float = nan) -> None:
        """Trip on a force outside its limits, a fault that the device reports, or a temperature above its limit.

        Parameters
        ----------
        force_N
            Force read [N].
        status
            Status bits of the device; see `piezod.transport.status`.
        now_ns
            Monotonic time of the reading [ns].
        temperature_C
            Temperature read [degC]; nan without a sensor.
        """
        cause = self.force.check(force_N, now_ns)
        self.amplifier_tripped = self.amplifier_tripped or bool(status & STATUS_FAULTS)
        self._watchdog_of_before = self._watchdog_of_before and bool(status & STATUS_WATCHDOG)
        if cause is not Cause.NONE:
            self.trip(cause)
        elif status & STATUS_FAULTS:
            self.trip(_device_fault(status))
        elif status & STATUS_WATCHDOG and not self._watchdog_of_before:
            self.trip(Cause.DEVICE_WATCHDOG)
        elif cause := self._device.check(status, now_ns) or self._temperature.check(temperature_C, now_ns):
            self.trip(cause)

    def check_response(self, reading: Reading, written_V: float, reference_N: float, now_ns: int) -> None:
        """Trip when the readings do not follow the written voltages, or the stack gets too hot.

        Parameters
        ----------
        written_V
            Voltage in force since this exchange [V].
        reference_N
            Reference of this voltage [N]; nan when it is no force, or the voltage was not written as planned.
        now_ns
            Monotonic time of the end of the exchange [ns].
        """
        cause = (
            self._stuck.check(reading.force_N, reading.heartbeat, written_V)
            or self._readback.check(reading.voltage_readback_V, written_V, now_ns)
            or self._tracking.check(reading.force_N, reference_N, now_ns)
            or self._heat.check(written_V)
        )
        if cause:
            self.trip(cause)

    def check_rate(self, missed_in_a_row: int) -> None:
        """Trip when the loop misses too many ticks: `missed_in_a_row`, or as many counted with a leak."""
        if not missed_in_a_row:
            if self._missed.level:
                self._missed.leak()
        elif self.driving and (self._missed.add() or missed_in_a_row >= self._most_missed):
            self.trip(Cause.MISSED_TICKS)

    def require(self, event: Event) -> State:
        """Next state for an event.

        Raises
        ------
        CheckFailedError
            The event may not come in the present state.
        """
        state = TRANSITIONS.get((self.state, event))
        if state is None:
            raise CheckFailedError(f"{event.value}: may not come in state {self.state.name}; nothing was changed")
        return state

    def apply(self, event: Event, cause: Cause) -> None:
        """Change the state by an event; the cause of an event that leaves it is not noted."""
        state = self.require(event)
        if state is not self.state:
            self.state, self.cause = state, cause


def _device_fault(status: int) -> Cause:
    """Cause of a reported fault; the order is mains, temperature, any other."""
    if status & STATUS_MAINS_LOST:
        return Cause.MAINS_LOST
    return Cause.DEVICE_TOO_HOT if status & STATUS_OVER_TEMPERATURE else Cause.DEVICE_FAULT
