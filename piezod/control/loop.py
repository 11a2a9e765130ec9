"""The control loop: reference -> plan -> limit -> exchange -> commit -> ring log -> keep time, once a tick.

The states that matter are those of the stack, so they move with the voltage that was really written, after every
limit and rounding (`link.written_V`), and only when the device acknowledged it. Nothing here raises for a bad sample.
"""

from dataclasses import dataclass
from math import isfinite

from piezod.config import LimitsConfig
from piezod.control.limits import Limiter
from piezod.control.rate_keeper import RateKeeper
from piezod.control.references import Freshness, Reference, TableReference
from piezod.control.ring_log import RingLog
from piezod.control.safety import Cause, State, Supervisor
from piezod.model import Compensator
from piezod.transport import ACKNOWLEDGED, ExchangeResult, Link


@dataclass(frozen=True)
class Segment:
    """One stretch of work: what is followed, how, and how it is approached.

    Parameters
    ----------
    name
        For people.
    reference
        What is followed [N], or driven [V] by a direct drive.
    compensator
        From reference to voltage.
    reset_cycle
        Voltages [V] driven before the first reference is approached, one a tick; None: straight to the reference.
    """

    name: str
    reference: Reference
    compensator: Compensator
    reset_cycle: TableReference | None = None


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
    """

    def __init__(
        self,
        link: Link,
        limits: LimitsConfig,
        rate_keeper: RateKeeper,
        ring_log: RingLog,
        dt_s: float,
        approach_V_per_s: float,
    ) -> None:
        self._link = link
        self._clock = rate_keeper
        self._ring = ring_log
        self._approach_V = approach_V_per_s * dt_s
        self._ramp_V = limits.ramp_down_V_per_s * dt_s
        self._safe_V = limits.voltage_safe_V
        self._segment: Segment | None = None
        self._number = -1
        self._approaching = False
        self._last_reference = 0.0
        self._stops_requested = 0
        self.limiter = Limiter(limits, dt_s)
        self.supervisor = Supervisor(limits)
        self.counts = LoopCounts()

    def request_stop(self) -> None:
        """Ramp down at the next tick, a second time: in haste; safe to call from a signal handler."""
        self._stops_requested += 1

    def begin(self, segment: Segment) -> None:
        """Take up a segment; it starts when the loop is armed."""
        self._segment = segment
        self._number += 1
        self._approaching = False
        segment.compensator.reset()
        if segment.reset_cycle is not None:
            segment.reset_cycle.start(self._clock.tick)

    @property
    def stopped(self) -> bool:
        """Whether a stop was requested."""
        return self._stops_requested > 0

    def drive(self, segment: Segment) -> Cause:
        """Arm, follow `segment` to its end, ramp down; returns the fault that ended it, or Cause.NONE."""
        self._arm(segment)
        self._clock.start()
        while self.supervisor.driving:
            self.tick()
            self._clock.wait()
        return self.supervisor.fault

    def watch(self, ticks: int | None = None) -> None:
        """Read without writing, for so many ticks or until stopped."""
        self._clock.start()
        while not self._stops_requested and ticks != 0:
            self.tick()
            self._clock.wait()
            ticks = None if ticks is None else ticks - 1

    def _arm(self, segment: Segment) -> None:
        readback_V = self._link.reading.voltage_readback_V
        self.limiter.applied_V = readback_V if isfinite(readback_V) else self._safe_V
        self.begin(segment)
        self.supervisor.arm(self._clock.now_ns())

    def tick(self) -> None:
        """One tick."""
        clock, limiter, link = self._clock, self.limiter, self._link
        begun_ns = clock.now_ns()
        planned_V = self._plan(clock.tick, begun_ns)
        if self.supervisor.driving:
            result = link.exchange(self._limit(planned_V))
            if result in ACKNOWLEDGED:
                limiter.applied_V = link.written_V
                if self._segment is not None:
                    self._segment.compensator.commit(link.written_V)
        else:
            result = link.poll()
        done_ns = clock.now_ns()
        self._judge(result, done_ns)
        self._log(planned_V, result, begun_ns, done_ns)

    def _plan(self, tick: int, now_ns: int) -> float:
        """Voltage wished for this tick [V]; moves the state machine along."""
        supervisor, segment = self.supervisor, self._segment
        if self._stops_requested:
            supervisor.stop(hasty=self._stops_requested > 1)
        if segment is None or not supervisor.driving or supervisor.state is State.RAMP_DOWN:
            return self._safe_V
        cycle = segment.reset_cycle
        if supervisor.state is State.ARMING and cycle is not None and not self._approaching:
            voltage_V = cycle.read(tick, now_ns)
            if cycle.freshness is Freshness.LIVE:
                return voltage_V
        if not self._approaching:
            self._approaching = True
            segment.reference.start(tick)
        return self._follow(segment, tick, now_ns)

    def _follow(self, segment: Segment, tick: int, now_ns: int) -> float:
        """Plan for the reference; while the first one is approached the reference stands at its start."""
        supervisor, reference = self.supervisor, segment.reference
        if supervisor.state is State.ARMING:
            reference.start(tick)
        value = reference.read(tick, now_ns)
        if reference.freshness is Freshness.LIVE:
            supervisor.resume()
            self._last_reference = value
            planned_V = segment.compensator.plan(value)
            if supervisor.state is State.ARMING and self._is_reached(planned_V):
                supervisor.reached()
            return planned_V
        if supervisor.state is State.ARMING and reference.freshness is Freshness.STALE:
            return self.limiter.applied_V
        lapse = Cause.REFERENCE_ENDED if reference.freshness is Freshness.ENDED else Cause.REFERENCE_STALE
        if reference.ramp_down_on_lapse:
            supervisor.stop(lapse)
            return self._safe_V
        supervisor.hold(lapse)
        return self.limiter.applied_V

    def _is_reached(self, planned_V: float) -> bool:
        limiter = self.limiter
        return abs(limiter.nearest(planned_V) - limiter.applied_V) <= self._approach_V

    def _limit(self, planned_V: float) -> float:
        state = self.supervisor.state
        if state is State.RAMP_DOWN and not self.supervisor.in_haste:
            return self.limiter.limit(planned_V, self._ramp_V)
        if state is State.ARMING and self._approaching:
            return self.limiter.limit(planned_V, self._approach_V)
        return self.limiter.limit(planned_V)

    def _judge(self, result: int, now_ns: int) -> None:
        supervisor, reading = self.supervisor, self._link.reading
        good = result == ExchangeResult.OK
        if not good:
            self.counts.failed_exchanges += 1
        supervisor.judge_exchange(good, now_ns)
        if good:
            supervisor.judge_reading(reading.force_N, reading.status)
        supervisor.judge_clock(self._clock.missed_in_a_row)
        if supervisor.state is State.RAMP_DOWN and abs(self.limiter.applied_V - self._safe_V) <= 1e-6 and good:
            supervisor.safe()

    def _log(self, planned_V: float, result: int, begun_ns: int, done_ns: int) -> None:
        reading, supervisor, clock = self._link.reading, self.supervisor, self._clock
        self.counts.ticks += 1
        self._ring.append(
            clock.tick,
            begun_ns,
            self._last_reference,
            planned_V,
            self.limiter.applied_V,
            reading.force_N,
            reading.voltage_readback_V,
            reading.temperature_C,
            clock.lateness_ns,
            done_ns - begun_ns,
            supervisor.state,
            result,
            self._number,
            supervisor.cause,
        )
