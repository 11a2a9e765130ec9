"""The control loop: reference -> plan -> limit -> exchange -> commit -> ring log -> keep time, once a tick.

The compensator's states are those of the stack. They advance with the voltage that was written after every limit and
rounding (`link.written_V`), and only when the device has acknowledged it. A bad sample raises no error in the loop.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan

from piezod.config import LimitsConfig
from piezod.config.sections import SignCheckConfig
from piezod.control.authority import AUTHORITY, Demand
from piezod.control.device_guard import DeviceGuard
from piezod.control.limits import Limiter
from piezod.control.phase_times import PhaseTimes
from piezod.control.rate_keeper import RateKeeper
from piezod.control.references import LiveReference
from piezod.control.segment_planner import Segment, SegmentPlanner
from piezod.control.sign_check import SignCheck
from piezod.control.states import Cause, Event, State
from piezod.control.supervisor import Supervisor
from piezod.control.voltage_writer import VoltageWriter
from piezod.recording.ring_log import RingLog
from piezod.runtime import clock
from piezod.transport import ACKNOWLEDGED, ExchangeResult, Link
from piezod.transport.status import STATUS_WATCHDOG

MOST_FAILED_TICKS = 3  # ticks that may raise an exception before the loop ends
AS_PLANNED_V = 1e-3  # rounding of a float32 on the wire


@dataclass
class LoopCounts:
    """Number of ticks and of failed exchanges since the loop was created."""

    ticks: int = 0
    failed_exchanges: int = 0


class ControlLoop:
    """Drives one segment after the other through a link.

    Parameters
    ----------
    link
        Opened link whose identity was verified.
    limits
        Section `limits` of the bench configuration.
    ring_log
        Log of every tick.
    dt_s
        Tick period [s].
    approach_V_per_s
        Rate of the approach to the first reference of a segment [V/s].
    sign_check
        Voltage step that must raise the force after arming; None: no sign check.
    readback_within_V
        Largest difference between safe voltage and readback at the end of a ramp down [V].
    watchdog_in_status
        Whether the device's status has the bit of its watchdog.
    phases
        Times of the phases of a tick; None: nobody reads them.

    Attributes
    ----------
    limiter
        Limiter of every voltage.
    supervisor
        State machine of the loop.
    counts
        Number of ticks and of failed exchanges.
    failure
        Type and text of the first exception of a tick; empty without one.
    """

    def __init__(
        self,
        link: Link,
        limits: LimitsConfig,
        rate_keeper: RateKeeper,
        ring_log: RingLog,
        dt_s: float,
        approach_V_per_s: float,
        *,
        sign_check: SignCheckConfig | None = None,
        readback_within_V: float = inf,
        watchdog_in_status: bool = True,
        phases: PhaseTimes | None = None,
    ) -> None:
        self._phases = phases or PhaseTimes()
        self._link, self._clock, self._ring = link, rate_keeper, ring_log
        self._dt_s, self._dt_ns = dt_s, round(dt_s * 1e9)
        self._readback_within_V = readback_within_V
        self._stop_requested = self._stop_fast = False
        self._failed_ticks = self._begun_ns = 0
        self._settling_ns = -1
        self.limiter, self.supervisor = Limiter(limits, dt_s), Supervisor(limits, dt_s)
        check = None if sign_check is None else SignCheck(sign_check, dt_s, limits.voltage_step_V)
        self.supervisor.show_counts(ring_log.counters)
        self._planner = SegmentPlanner(self.limiter, self.supervisor, check, approach_V_per_s * dt_s)
        self._guard = DeviceGuard(link, self.supervisor, rate_keeper)
        self._writer = VoltageWriter(
            link,
            self.limiter,
            self.supervisor,
            rate_keeper,
            limits,
            dt_s,
            readback_within_V=readback_within_V,
            watchdog_in_status=watchdog_in_status,
        )
        self.counts = LoopCounts()
        self.failure = ""
        self._set_own_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits between two ticks; state, voltage and latched fault stay."""
        self._set_own_limits(limits)
        self.limiter.set_limits(limits)
        self.supervisor.set_limits(limits)
        self._writer.set_limits(limits)

    def _set_own_limits(self, limits: LimitsConfig) -> None:
        self._ramp_V = limits.ramp_down_V_per_s * self._dt_s
        self._safe_V = limits.voltage_safe_V
        self._low_V, self._high_V = limits.voltage_min_V, limits.voltage_max_V
        self._as_planned_V = max(limits.voltage_step_V, AS_PLANNED_V)
        self._comm_loss_ns = round(1e6 * limits.comm_loss_ms)

    def request_stop(self, *, fast: bool = False) -> None:
        """Ramp down at the next tick; repeated requests change nothing. Safe in a signal handler.

        Parameters
        ----------
        fast
            Ramp down as fast as the slew limit allows; a later request without it does not slow the ramp.
        """
        self._stop_requested = True
        self._stop_fast = self._stop_fast or fast

    @property
    def ring_log(self) -> RingLog:
        """Log of the ticks."""
        return self._ring

    @property
    def stopped(self) -> bool:
        """Whether a stop was requested."""
        return self._stop_requested

    @property
    def at_rest(self) -> bool:
        """Whether the last readback is the safe voltage; True for a device without readback."""
        return self._is_safe(self._link.reading.voltage_readback_V)

    @property
    def _is_below_rest(self) -> bool:
        """Whether the output is nearer to zero than the safe voltage: a stop would raise it."""
        return abs(self._link.reading.voltage_readback_V) <= abs(self._safe_V)

    def begin(self, segment: Segment) -> None:
        """Select `segment`; it starts when the loop is armed."""
        self._planner.begin(segment, self._clock.tick)

    def observe(self, segment: Segment, ring_log: RingLog) -> None:
        """Receive the values of `segment`'s reference from now on, also at rest, and count them in the ring log."""
        self._planner.observe(segment.reference)
        if isinstance(segment.reference, LiveReference):
            segment.reference.counts = ring_log.counters

    def arm(self, segment: Segment) -> None:
        """Start `segment` from the voltage that is read back; refused unless the state is DISARMED."""
        self.supervisor.require(Event.ARM)
        readback_V = self._link.reading.voltage_readback_V
        self._start_from(readback_V if isfinite(readback_V) else self._safe_V)
        self.begin(segment)
        self.supervisor.arm(self._clock.now_ns(), self._planner.preparation_ticks * self._dt_ns)

    def drive(self, segment: Segment) -> Cause:
        """Arm, follow `segment` to its end and ramp down; the result is the fault, or `Cause.NONE`."""
        self.arm(segment)
        return self._drive_to_rest()

    def bring_down(self, from_V: float) -> Cause:
        """Ramp down an output that stands at `from_V` [V]; the result is the fault, or `Cause.NONE`."""
        self._begin_ramp_down(from_V)
        return self._drive_to_rest()

    def bring_down_left_output(self) -> None:
        """Ramp down an output that stands while nothing is driven, such as one that ignored the last ramp.

        No effect while voltages are written, at rest, without a readback, or while the watchdog of the device acts.
        No effect on an output nearer to zero than the safe voltage, which a stop would raise.
        """
        if self.supervisor.driving or self._link.poll() is not ExchangeResult.OK:
            return
        reading = self._link.reading
        left = isfinite(reading.voltage_readback_V) and not self.at_rest and not self._is_below_rest
        if left and not reading.status & STATUS_WATCHDOG:
            self._begin_ramp_down(reading.voltage_readback_V)

    def serve(self, after_tick: Callable[[], None]) -> None:
        """Run ticks until a stop is requested and the bench is at rest; call `after_tick` after each.

        An exception of `after_tick` while voltages are written latches a fault and ramps down; it never ends the ramp.

        Raises
        ------
        Exception
            `after_tick` raised it while nothing was driven.
        """
        self._clock.start()
        while self.supervisor.driving or not self._stop_requested:
            self.run_tick()
            self._call_guarded(after_tick)
            self.wait()

    def _call_guarded(self, after_tick: Callable[[], None]) -> None:
        """Call `after_tick`; while voltages are written, its exception requests a ramp down and the end."""
        try:
            after_tick()
        except Exception as error:
            if not (self.supervisor.driving or self._stop_requested):
                raise
            self.failure = self.failure or f"{type(error).__name__}: {error}"
            self.supervisor.trip(Cause.CONTROLLER)
            self.request_stop()

    def _begin_ramp_down(self, from_V: float) -> None:
        self._start_from(from_V)
        self.supervisor.bring_down(self._clock.now_ns())

    def _start_from(self, output_V: float) -> None:
        self._clock.start()
        self._begun_ns = self._clock.now_ns()
        self._writer.start_from(output_V)

    def _drive_to_rest(self) -> Cause:
        while self.supervisor.driving:
            self.run_tick()
            self.wait()
        return self.supervisor.fault

    def wait(self) -> None:
        """Wait for the next tick; compare the command of the device shortly before it, when that is due."""
        result = self._guard.compare_command()
        if result > ExchangeResult.UNVERIFIED:
            self._writer.name_restart()
            self._guard.evaluate(result)
        self._clock.wait()

    def run_tick(self) -> None:
        """Run one tick; after an exception in it, ramp down without the compensator.

        Raises
        ------
        Exception
            More than `MOST_FAILED_TICKS` ticks raised one. The loop ends, and the device watchdog takes over.
        """
        try:
            self.tick()
        except Exception as error:
            self._failed_ticks += 1
            if self._failed_ticks > MOST_FAILED_TICKS:
                raise
            self.failure = self.failure or f"{type(error).__name__}: {error}"
            self.supervisor.trip(Cause.CONTROLLER)

    def tick(self) -> None:
        """Run one tick: plan, exchange, check, log."""
        keeper, supervisor = self._clock, self.supervisor
        begun_ns = keeper.now_ns()
        supervisor.check_pause(begun_ns - self._begun_ns)
        self._begun_ns = begun_ns
        if self._stop_requested:
            supervisor.stop(fast=self._stop_fast)
        drives, stamp = supervisor.driving, clock.perf_counter_ns
        started = self._planner.read_ns = stamp()
        planned_V = self._planner.plan_voltage(keeper.tick, begun_ns, self._safe_V)
        planned = stamp()
        self._act_on(self._planner.event)
        result = self._exchange(planned_V, begun_ns)
        done_ns, done = keeper.now_ns(), stamp()
        self._check(result, planned_V, done_ns)
        checked = stamp()
        self._log(planned_V, result, begun_ns, done_ns)
        if drives:
            self._phases.add_tick(started, self._planner.read_ns, planned, done, checked, stamp())
        self._guard.end_tick(result, begun_ns, done_ns)

    def _act_on(self, event: Cause) -> None:
        """Change the state by an event of the planner."""
        supervisor, segment = self.supervisor, self._planner.segment
        if event is Cause.NONE or segment is None:
            return
        if event is Cause.REFERENCE_REACHED:
            supervisor.start_running()
        elif event is Cause.REFERENCE_LIVE:
            supervisor.apply(Event.LIVE, event)
        elif segment.reference.ramp_down_on_lapse:
            supervisor.stop(event)
        else:
            supervisor.apply(Event.LAPSED, event)

    def _exchange(self, planned_V: float, begun_ns: int) -> ExchangeResult:
        """Write and commit while voltages are driven; only read otherwise."""
        supervisor, segment, link = self.supervisor, self._planner.segment, self._link
        link.time_limit_s = supervisor.exchange_time_left_s(begun_ns)
        if not supervisor.driving:
            result = link.poll()
            if result is ExchangeResult.ECHO_MISMATCH:  # it stays in the device; one report is enough
                link.accept_foreign_command()
            return result
        demand = supervisor.demand
        self.limiter.at_once = AUTHORITY[demand].at_once
        result = self._writer.write(planned_V, begun_ns, self._largest_change_V(demand))
        failed = self._writer.output_uncertain or supervisor.fault is Cause.CONTROLLER
        if segment is not None and not failed:
            segment.compensator.commit(link.written_V)
            if segment.update_temperature is not None:
                segment.update_temperature(link.reading.temperature_C)
        return result

    def _largest_change_V(self, demand: Demand) -> float:
        """Largest change in this tick [V]; infinite where only the slew limits it."""
        motion = AUTHORITY[demand]
        if motion.at_slew:
            return inf
        return self._ramp_V if motion.to_safe else self._planner.largest_change_V

    def _check(self, result: int, planned_V: float, now_ns: int) -> None:
        """Check the exchange and its reading against every limit."""
        supervisor, reading, planner = self.supervisor, self._link.reading, self._planner
        not_written = self._writer.output_uncertain and supervisor.driving
        good = result == ExchangeResult.OK and not not_written
        if not good:
            self.counts.failed_exchanges += 1
        answered = result in ACKNOWLEDGED and not not_written
        self._guard.evaluate(result)
        supervisor.check_exchange(good, now_ns, answered=answered, ahead_ns=self._dt_ns // 2)
        if good and supervisor.driving:
            applied_V = self.limiter.applied_V
            expected_N = self._expected_N(planned_V, reading.force_N)
            supervisor.force.count_braking(reading.force_N, applied_V, self.limiter.braking_V)
            supervisor.check_reading(reading.force_N, reading.status, now_ns, reading.temperature_C)
            supervisor.check_response(reading, applied_V, expected_N, now_ns)
            if not planner.sign_is_right(reading.force_N):
                supervisor.trip(Cause.SIGN_CHECK)
        supervisor.check_rate(self._clock.missed_in_a_row)
        if supervisor.state is State.RAMP_DOWN:
            self._check_rest(good, reading.voltage_readback_V, now_ns)
        else:
            self._settling_ns = -1
        supervisor.check_arming(now_ns)  # last: the ring log shows its cause even where the output is at rest already

    def _expected_N(self, planned_V: float, force_N: float) -> float:
        """Force that the tracking interlock compares with [N]; nan where none is expected.

        The reference, where its voltage was written as planned. Else what the written voltage should give; where the
        voltage is at an end of its range, the farther of both, so that a reference out of reach does not pass.
        """
        planner, state = self._planner, self.supervisor.state
        applied_V = self.limiter.applied_V
        if abs(planned_V - applied_V) <= self._as_planned_V and state is not State.HOLD:
            return planner.expected_force_N
        segment = planner.segment
        if segment is None or not segment.follows_force or state not in (State.RUNNING, State.HOLD):
            return nan
        produced_N = segment.compensator.produced_N()
        railed = self._low_V < self._high_V and not self._low_V < planned_V < self._high_V
        if railed and abs(force_N - planner.reference) > abs(force_N - produced_N):
            return planner.reference
        return produced_N

    def _check_rest(self, good: bool, readback_V: float, now_ns: int) -> None:
        """End the ramp down when the safe voltage is written and read back; trip when the readback stays away."""
        if not good or abs(self.limiter.applied_V - self._safe_V) > 1e-6:
            self._settling_ns = -1
            if good:
                self._follow_output(readback_V)
            return
        if self._settling_ns < 0:
            self._settling_ns = now_ns
        if self._is_safe(readback_V):
            self.supervisor.end_ramp_down()
        elif now_ns - self._settling_ns > self._comm_loss_ns:
            self.supervisor.trip(Cause.READBACK)
            self.supervisor.end_ramp_down()

    def _follow_output(self, readback_V: float) -> None:
        """Continue the ramp of a tripped amplifier at rest: switched on again, it would jump to the last voltage.

        An amplifier that is too hot may still drive. It is off only where its output is far nearer to rest than the
        voltage that was written; else the ramp goes on to its end.
        """
        dropped = abs(self.limiter.applied_V - self._safe_V) > 2.0 * self._readback_within_V
        if dropped and self.supervisor.amplifier_tripped and isfinite(readback_V) and self._is_safe(readback_V):
            self.limiter.applied_V = self._safe_V

    def _is_safe(self, readback_V: float) -> bool:
        return isnan(readback_V) or abs(readback_V - self._safe_V) <= self._readback_within_V

    def _log(self, planned_V: float, result: int, begun_ns: int, done_ns: int) -> None:
        reading, supervisor, keeper = self._link.reading, self.supervisor, self._clock
        self.counts.ticks += 1
        self._ring.append(
            keeper.tick,
            begun_ns,
            self._planner.reference,
            planned_V,
            self.limiter.applied_V,
            reading.force_N,
            reading.voltage_readback_V,
            reading.temperature_C,
            keeper.lateness_ns,
            done_ns - begun_ns,
            supervisor.state,
            result,
            self._planner.number,
            supervisor.cause,
        )
