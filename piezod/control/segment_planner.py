"""The planned voltage of every tick of a segment: sign check, reset cycle, approach, then the reference."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, inf, isnan, nan

from piezod.control.authority import AUTHORITY
from piezod.control.limits import Limiter
from piezod.control.references import Freshness, Reference, TableReference
from piezod.control.sign_check import SignCheck
from piezod.control.states import Cause, State
from piezod.control.supervisor import Supervisor
from piezod.model import Compensator
from piezod.runtime import clock


@dataclass(frozen=True)
class Segment:
    """One reference, with the compensator and the preparation that belong to it.

    Parameters
    ----------
    name
        Name for messages.
    reference
        Force to follow [N]; voltage to write [V] with `DirectDrive`.
    compensator
        Conversion of the reference into a voltage.
    reset_cycle
        Voltages [V] that are written before the approach, one a tick; None: no reset cycle.
    follows_force
        Whether the reference is a force. With `DirectDrive` it is a voltage.
    update_temperature
        Function that takes every temperature read [degC]; None: the compensator needs no temperature.
    """

    name: str
    reference: Reference
    compensator: Compensator
    reset_cycle: TableReference | None = None
    follows_force: bool = True
    update_temperature: Callable[[float], None] | None = None


class SegmentPlanner:
    """Plans the voltage of every tick of a segment, before the limits apply.

    The planner never changes the supervisor's state. It reports what happened as `event`, and the loop acts on it.

    Parameters
    ----------
    limiter
        Source of the voltage in force; only read.
    supervisor
        Source of the state; only read.
    sign_check
        Voltage step that must raise the force after arming; None: no sign check.
    approach_V
        Largest change per tick while the first reference is approached [V].

    Attributes
    ----------
    segment
        Segment that is driven; None before the first.
    number
        Number of the segment, from 0; -1 before the first.
    reference
        Value of the reference in the last tick that followed it.
    expected_force_N
        Force that the planned voltage should produce [N]; nan where none is expected.
    preparation_ticks
        Planned length of sign check, reset cycle and approach, the approach from end to end of the range [ticks].
    read_ns
        Time at which the reference was read last (`clock.perf_counter_ns`) [ns].
    event
        Event of the tick planned last: `Cause.NONE`, REFERENCE_REACHED (the first reference), REFERENCE_LIVE (again,
        after a hold), REFERENCE_ENDED or REFERENCE_STALE.
    """

    def __init__(
        self, limiter: Limiter, supervisor: Supervisor, sign_check: SignCheck | None, approach_V: float
    ) -> None:
        self._limiter, self._supervisor = limiter, supervisor
        self._sign_check = sign_check
        self._approach_V = approach_V
        self.preparation_ticks = self.read_ns = 0
        self._checking_sign = self._cycling = self._approaching = False
        self._at_rest: Reference | None = None
        self.segment: Segment | None = None
        self.number = -1
        self.reference = 0.0
        self.expected_force_N = nan
        self.event = Cause.NONE

    @property
    def largest_change_V(self) -> float:
        """Largest change in this tick [V]; infinite except in the sign check and the approach."""
        slow = self._supervisor.state is State.ARMING and (self._approaching or self._checking_sign)
        return self._approach_V if slow else inf

    def begin(self, segment: Segment, tick: int) -> None:
        """Select `segment` and start its preparation at `tick`.

        The compensator is reset, except where the same segment begins again without a reset cycle: its states still
        match the stack then.
        """
        if segment is not self.segment or segment.reset_cycle is not None:
            segment.compensator.reset()
        self.segment = segment
        self.observe(segment.reference)
        segment.reference.begin()
        self.number += 1
        self.preparation_ticks = self._planned_ticks(segment)
        self._checking_sign = self._sign_check is not None
        self._cycling = segment.reset_cycle is not None
        self._approaching = False
        if self._sign_check is not None:
            self._sign_check.start(self._limiter.applied_V)
        elif segment.reset_cycle is not None:
            segment.reset_cycle.start(tick)

    def _planned_ticks(self, segment: Segment) -> int:
        """Planned length of the preparation of `segment` [ticks]; the sign check rises and falls at the slow rate."""
        ticks = self._limiter.span_V / self._approach_V
        if self._sign_check is not None:
            ticks += 2 * self._sign_check.window + 2 * self._sign_check.step_V / self._approach_V
        return ceil(ticks) + (0 if segment.reset_cycle is None else len(segment.reset_cycle))

    def observe(self, reference: Reference) -> None:
        """Receive the values of `reference` in every tick that does not follow it, so that none gets old unseen."""
        self._at_rest = reference

    def sign_is_right(self, force_N: float) -> bool:
        """Add a good reading [N] to the sign check; False when the force has not risen with the step."""
        check = self._sign_check
        if check is None or not self._checking_sign or self._supervisor.state is not State.ARMING:
            return True
        return check.add_reading(force_N, self._limiter.applied_V)

    def plan_voltage(self, tick: int, now_ns: int, safe_V: float) -> float:
        """Voltage of one tick [V]; sets `event`.

        Parameters
        ----------
        now_ns
            Monotonic time at its begin [ns].
        safe_V
            Voltage of a bench at rest [V].
        """
        supervisor, segment = self._supervisor, self.segment
        self.expected_force_N = nan
        # The event is an attribute: a returned pair (voltage, event) would be a new container in every tick.
        self.event = Cause.NONE
        if segment is None or not supervisor.driving or AUTHORITY[supervisor.demand].to_safe:
            self._receive(now_ns)
            return safe_V
        if supervisor.readings_stale:
            self._receive(now_ns)
            return self._limiter.applied_V
        if supervisor.state is State.ARMING and not self._approaching:
            planned_V = self._prepare(segment, tick, now_ns)
            if not isnan(planned_V):
                self._receive(now_ns)
                return planned_V
            self._approaching = True
            segment.reference.start(tick)
        return self._follow(segment, tick, now_ns, safe_V)

    def _receive(self, now_ns: int) -> None:
        if self._at_rest is not None:
            self._at_rest.idle(now_ns)

    def _prepare(self, segment: Segment, tick: int, now_ns: int) -> float:
        """Voltage of the sign check, then of the reset cycle [V]; nan after both."""
        if self._checking_sign and self._sign_check is not None:
            planned_V = self._sign_check.plan_voltage(self._limiter.applied_V)
            if not self._sign_check.done:
                return planned_V
            self._checking_sign = False
            if segment.reset_cycle is not None:
                segment.reset_cycle.start(tick)
        if self._cycling and segment.reset_cycle is not None:
            voltage_V = segment.reset_cycle.read(tick, now_ns)
            if segment.reset_cycle.freshness is Freshness.LIVE:
                return voltage_V
            self._cycling = False
        return nan

    def _follow(self, segment: Segment, tick: int, now_ns: int, safe_V: float) -> float:
        """Voltage for the reference [V]; during the approach the reference stays at its first value."""
        state, reference = self._supervisor.state, segment.reference
        if state is State.ARMING:
            reference.start(tick)
        value = reference.read(tick, now_ns)
        self.read_ns = clock.perf_counter_ns()
        if reference.freshness is Freshness.LIVE:
            self.reference = value
            if state is State.HOLD:
                self.event = Cause.REFERENCE_LIVE
            planned_V = segment.compensator.plan(reference.ahead)
            reached = state is not State.ARMING or self._is_reached(planned_V)
            if state is State.ARMING and reached:
                self.event = Cause.REFERENCE_REACHED
            if segment.follows_force and reached:
                self.expected_force_N = value
            return planned_V
        if state is State.ARMING and reference.freshness is Freshness.STALE:
            return self._limiter.applied_V
        ended = reference.freshness is Freshness.ENDED
        self.event = Cause.REFERENCE_ENDED if ended else Cause.REFERENCE_STALE
        return safe_V if reference.ramp_down_on_lapse else self._limiter.applied_V

    def _is_reached(self, planned_V: float) -> bool:
        limiter = self._limiter
        return abs(limiter.nearest(planned_V) - limiter.applied_V) <= self._approach_V
