"""The control loop: reference -> plan -> limit -> exchange -> commit -> ring log -> keep time, once a tick.

The states that matter are those of the stack, so they move with the voltage that was really written, after every
limit and rounding (`link.written_V`), and only when the device acknowledged it. Nothing here raises for a bad sample.

After an exchange that failed, or a pause, the loop looks before it writes: a device that was restarted, or whose
watchdog has acted, drives its output by itself, and any voltage written then would be a jump.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan

from piezod.config import LimitsConfig, SignCheckConfig
from piezod.control.arming import SignCheck
from piezod.control.interlocks import STATUS_WATCHDOG
from piezod.control.limits import Limiter
from piezod.control.rate_keeper import RateKeeper
from piezod.control.segment_planner import Course, Segment
from piezod.control.supervisor import Cause, State, Supervisor
from piezod.recording.ring_log import RingLog
from piezod.transport import ACKNOWLEDGED, ExchangeResult, Link

__all__ = ["ControlLoop", "LoopCounts", "Segment"]

MOST_FAILURES = 3  # ticks that may raise before the loop itself is given up
AS_PLANNED_V = 1e-3  # float32 on the wire and a rounding in between


@dataclass
class LoopCounts:
    """What one run of the loop counted."""

    ticks: int = 0
    failed_exchanges: int = 0


class ControlLoop:
    """Drives one segment after the other through a link.

    Parameters
    ----------
    link
        An opened link whose identity was verified.
    limits
        The `limits` section.
    rate_keeper
        The clock.
    ring_log
        Where every tick is written.
    dt_s
        Tick period [s].
    approach_V_per_s
        How fast the first reference of a segment is approached [V/s].
    sign_check
        The step that must raise the force after arming; None: without.
    readback_within_V
        How near to the safe voltage the output must be read back before a ramp down is over [V].
    watchdog_shows
        Whether the device's status says that its watchdog has tripped.
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
        watchdog_shows: bool = True,
    ) -> None:
        self._link = link
        self._clock = rate_keeper
        self._ring = ring_log
        self._dt_s, self._dt_ns = dt_s, round(dt_s * 1e9)
        self._approach_V = approach_V_per_s * dt_s
        self._readback_within_V = readback_within_V
        self._watchdog_shows = watchdog_shows
        self._stops_requested = 0
        self._begun_ns = self._acknowledged_ns = 0
        self._sent_ns = -self._dt_ns
        self._doubtful = False
        self._settling_ns = -1
        self._failures = 0
        self.limiter = Limiter(limits, dt_s)
        self.supervisor = Supervisor(limits, dt_s)
        check = None if sign_check is None else SignCheck(sign_check, dt_s, limits.voltage_step_V)
        self._course = Course(self.limiter, self.supervisor, check, self._approach_V)
        self.counts = LoopCounts()
        self.failure = ""
        self._keep(limits)

    def _keep(self, limits: LimitsConfig) -> None:
        self._ramp_V = limits.ramp_down_V_per_s * self._dt_s
        self._safe_V = limits.voltage_safe_V
        self._as_planned_V = max(limits.voltage_step_V, AS_PLANNED_V)
        self._comm_loss_ns = round(1e6 * limits.comm_loss_ms)
        self._watchdog_ns = round(1e6 * limits.device_watchdog_ms)
        self._look_after_ns = self._watchdog_ns // 2 or self._comm_loss_ns
        margin_ns = max(2 * self._dt_ns, self._watchdog_ns // 10)
        self._too_late_ns = self._watchdog_ns - margin_ns if self._watchdog_ns else 1 << 62

    def take_limits(self, limits: LimitsConfig) -> None:
        """Go on within these, between two ticks; state, voltage and latched fault stay."""
        self._keep(limits)
        self.limiter.take_limits(limits)
        self.supervisor.take_limits(limits)

    def request_stop(self) -> None:
        """Ramp down at the next tick, a second time: in haste; safe to call from a signal handler."""
        self._stops_requested += 1

    @property
    def stopped(self) -> bool:
        """Whether a stop was requested."""
        return self._stops_requested > 0

    def begin(self, segment: Segment) -> None:
        """Take up a segment; it starts when the loop is armed."""
        self._course.begin(segment, self._clock.tick)

    def arm(self, segment: Segment) -> None:
        """Start `segment` from the voltage that is read back; nothing happens unless the bench is disarmed."""
        if self.supervisor.state is not State.DISARMED:
            return
        readback_V = self._link.reading.voltage_readback_V
        self._start_from(readback_V if isfinite(readback_V) else self._safe_V)
        self.begin(segment)
        self.supervisor.arm(self._clock.now_ns())

    def drive(self, segment: Segment) -> Cause:
        """Arm, follow `segment` to its end, ramp down; returns the fault that ended it, or Cause.NONE."""
        self.arm(segment)
        return self._drive_to_rest()

    def bring_down(self, from_V: float) -> Cause:
        """Ramp down from an output that was found at `from_V`; returns the fault, or Cause.NONE."""
        self._start_from(from_V)
        self.supervisor.bring_down(self._clock.now_ns())
        return self._drive_to_rest()

    def watch(self, ticks: int | None = None) -> None:
        """Read without writing, for so many ticks or until stopped."""
        self._clock.start()
        while not self._stops_requested and ticks != 0:
            self.run_tick()
            self._clock.wait()
            ticks = None if ticks is None else ticks - 1

    def serve(self, attend: Callable[[], None]) -> None:
        """Tick until a stop was requested and the bench is at rest; `attend` is called in the pause after each tick."""
        self._clock.start()
        while self.supervisor.driving or not self._stops_requested:
            self.run_tick()
            attend()
            self._clock.wait()

    def _start_from(self, output_V: float) -> None:
        self.limiter.applied_V = output_V
        self._clock.start()
        now_ns = self._clock.now_ns()
        self._begun_ns = self._acknowledged_ns = now_ns
        self._sent_ns = now_ns - self._dt_ns
        self._doubtful = False

    def _drive_to_rest(self) -> Cause:
        while self.supervisor.driving:
            self.run_tick()
            self._clock.wait()
        return self.supervisor.fault

    def run_tick(self) -> None:
        """One tick; when the controller raises, the bench is ramped down without it.

        Raises
        ------
        Exception
            Ramping down raises too: the loop is given up, and the device's watchdog acts.
        """
        try:
            self.tick()
        except Exception as error:
            self._failures += 1
            if self._failures > MOST_FAILURES:
                raise
            self.failure = self.failure or f"{type(error).__name__}: {error}"
            self.supervisor.trip(Cause.CONTROLLER)

    def tick(self) -> None:
        """One tick."""
        clock, supervisor = self._clock, self.supervisor
        begun_ns = clock.now_ns()
        supervisor.judge_gap(begun_ns - self._begun_ns)
        self._begun_ns = begun_ns
        if self._stops_requested:
            supervisor.stop(hasty=self._stops_requested > 1)
        planned_V = self._course.wish(clock.tick, begun_ns, self._safe_V)
        self._link.patience_s = supervisor.patience_s(begun_ns)
        if not supervisor.driving:
            result = self._link.poll()
        elif self._doubtful or begun_ns - self._acknowledged_ns >= self._look_after_ns:
            result = self._look_and_write(planned_V, begun_ns)
        else:
            result = self._write(planned_V, begun_ns)
        done_ns = clock.now_ns()
        self._judge(result, planned_V, done_ns)
        self._log(planned_V, result, begun_ns, done_ns)

    def _write(self, planned_V: float, begun_ns: int) -> ExchangeResult:
        """Limit, write, commit: the one place where a voltage goes onto the wire.

        A process that was stopped since the tick began does not write: the device may have taken over meanwhile.
        """
        limiter, link, segment = self.limiter, self._link, self._course.segment
        stopped_ns = self._clock.now_ns() - begun_ns
        if stopped_ns >= self._look_after_ns:
            self._doubtful = True
            self.supervisor.judge_gap(stopped_ns)
            return ExchangeResult.TIMEOUT
        elapsed_ns = begun_ns - self._sent_ns
        share = 1.0 if 10 * elapsed_ns >= 9 * self._dt_ns else elapsed_ns / self._dt_ns
        result = link.exchange(limiter.limit(planned_V, self._change_V(), share))
        self._sent_ns = begun_ns
        self._doubtful = result not in ACKNOWLEDGED
        if self._doubtful:
            limiter.perhaps_sent(link.written_V)
            return result
        limiter.acknowledged(link.written_V)
        self._acknowledged_ns = begun_ns
        if segment is not None and self.supervisor.fault is not Cause.CONTROLLER:
            segment.compensator.commit(link.written_V)
            if segment.feel is not None:
                segment.feel(link.reading.temperature_C)
        return result

    def _change_V(self) -> float:
        """Largest change in this tick [V], if smaller than the slew limit allows."""
        supervisor = self.supervisor
        if supervisor.suspicious or (supervisor.state is State.RAMP_DOWN and not supervisor.in_haste):
            return self._ramp_V
        return self._approach_V if self._course.gentle else inf

    def _look_and_write(self, planned_V: float, begun_ns: int) -> ExchangeResult:
        """Write only if the device is still where it was left, and will be when the command arrives."""
        result = self._look()
        silent_ns = self._clock.now_ns() - self._acknowledged_ns
        self._doubtful = True
        if result != ExchangeResult.OK or not self.supervisor.driving or silent_ns >= self._too_late_ns:
            return result
        result = self._write(planned_V, begun_ns)
        if result == ExchangeResult.HEARTBEAT_STOOD:  # no new sample since the look, whose reading is good
            return ExchangeResult.OK
        return result

    def _look(self) -> ExchangeResult:
        """Read, and leave the output to a device that has taken it over."""
        reading, supervisor = self._link.reading, self.supervisor
        heartbeat = reading.heartbeat
        result = self._link.poll()
        if result != ExchangeResult.OK:
            return result
        silent = 0 < self._watchdog_ns <= self._clock.now_ns() - self._acknowledged_ns
        if silent and (not self._watchdog_shows or reading.status & STATUS_WATCHDOG):
            supervisor.trip(Cause.DEVICE_WATCHDOG)
        elif (reading.heartbeat - heartbeat) & 0xFFFF >= 0x8000 or self._has_fallen(reading.voltage_readback_V):
            supervisor.trip(Cause.DEVICE_RESTARTED)
        return result

    def _has_fallen(self, readback_V: float) -> bool:
        """Whether the output is nearer to rest than it was left: the device was restarted, or is off."""
        limiter, safe_V = self.limiter, self._safe_V
        left_V = min(abs(limiter.lowest_sent_V - safe_V), abs(limiter.highest_sent_V - safe_V))
        return abs(readback_V - safe_V) < left_V - self._readback_within_V  # never, with nan

    def _judge(self, result: int, planned_V: float, now_ns: int) -> None:
        supervisor, reading = self.supervisor, self._link.reading
        withheld = self._doubtful and supervisor.driving
        good = result == ExchangeResult.OK and not withheld
        if not good:
            self.counts.failed_exchanges += 1
        answered = result in ACKNOWLEDGED and not withheld
        supervisor.judge_exchange(good, now_ns, answered=answered, ahead_ns=self._dt_ns // 2)
        if good and supervisor.driving:
            applied_V, course = self.limiter.applied_V, self._course
            as_planned = abs(planned_V - applied_V) <= self._as_planned_V
            supervisor.judge_reading(reading.force_N, reading.status, now_ns, reading.temperature_C)
            supervisor.judge_drive(reading, applied_V, course.due_reference_N if as_planned else nan, now_ns)
            course.take(reading.force_N)
        supervisor.judge_clock(self._clock.missed_in_a_row)
        if supervisor.state is State.RAMP_DOWN:
            self._judge_rest(good, reading.voltage_readback_V, now_ns)
        else:
            self._settling_ns = -1

    def _judge_rest(self, good: bool, readback_V: float, now_ns: int) -> None:
        """The ramp is over when the safe voltage is written and read back; an output that does not come is a fault."""
        if not good or abs(self.limiter.applied_V - self._safe_V) > 1e-6:
            self._settling_ns = -1
            return
        if self._settling_ns < 0:
            self._settling_ns = now_ns
        if isnan(readback_V) or abs(readback_V - self._safe_V) <= self._readback_within_V:
            self.supervisor.safe()
        elif now_ns - self._settling_ns > self._comm_loss_ns:
            self.supervisor.trip(Cause.READBACK)
            self.supervisor.safe()

    def _log(self, planned_V: float, result: int, begun_ns: int, done_ns: int) -> None:
        reading, supervisor, clock = self._link.reading, self.supervisor, self._clock
        self.counts.ticks += 1
        self._ring.append(
            clock.tick,
            begun_ns,
            self._course.reference,
            planned_V,
            self.limiter.applied_V,
            reading.force_N,
            reading.voltage_readback_V,
            reading.temperature_C,
            clock.lateness_ns,
            done_ns - begun_ns,
            supervisor.state,
            result,
            self._course.number,
            supervisor.cause,
        )
