"""The course of one segment: sign check, reset cycle, approach, then the reference; what is wished, tick by tick."""

from collections.abc import Callable
from dataclasses import dataclass
from math import isnan, nan

from piezod.control.arming import SignCheck
from piezod.control.limits import Limiter
from piezod.control.references import Freshness, Reference, TableReference
from piezod.control.supervisor import Cause, State, Supervisor
from piezod.model import Compensator


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
    follows_force
        Whether the reference is a force; a direct drive's is not.
    feel
        Takes every temperature that is read [degC]; None where nothing depends on it.
    """

    name: str
    reference: Reference
    compensator: Compensator
    reset_cycle: TableReference | None = None
    follows_force: bool = True
    feel: Callable[[float], None] | None = None


class Course:
    """What is wished for each tick of a segment, whatever the limits then make of it.

    Parameters
    ----------
    limiter
        Knows the voltage in force.
    supervisor
        Whose state machine the course moves along.
    sign_check
        The step that must raise the force after arming; None: without.
    approach_V
        Change in a tick while the first reference is approached [V].

    Attributes
    ----------
    segment
        What is followed; None before the first.
    number
        Of the segment, from 0; -1 before the first.
    reference
        The value followed last.
    due_reference_N
        The force that this tick's voltage should lead to [N]; nan where none is due.
    """

    def __init__(
        self, limiter: Limiter, supervisor: Supervisor, sign_check: SignCheck | None, approach_V: float
    ) -> None:
        self._limiter, self._supervisor = limiter, supervisor
        self._sign_check = sign_check
        self._approach_V = approach_V
        self._probing = self._cycling = self._approaching = False
        self.segment: Segment | None = None
        self.number = -1
        self.reference = 0.0
        self.due_reference_N = nan

    @property
    def gentle(self) -> bool:
        """Whether the way is gone no faster than the approach."""
        return self._supervisor.state is State.ARMING and (self._approaching or self._probing)

    def begin(self, segment: Segment, tick: int) -> None:
        """Take up a segment; one taken up again without a reset cycle knows the stack already."""
        if segment is not self.segment or segment.reset_cycle is not None:
            segment.compensator.reset()
        self.segment = segment
        self.number += 1
        self._probing = self._sign_check is not None
        self._cycling = segment.reset_cycle is not None
        self._approaching = False
        if self._sign_check is not None:
            self._sign_check.start(self._limiter.applied_V)
        elif segment.reset_cycle is not None:
            segment.reset_cycle.start(tick)

    def take(self, force_N: float) -> None:
        """Take a good reading; while the sign is checked it must rise with the step."""
        check = self._sign_check
        if (
            self._probing
            and check is not None
            and self._supervisor.state is State.ARMING
            and not check.take(force_N, self._limiter.applied_V)
        ):
            self._supervisor.trip(Cause.SIGN_CHECK)

    def wish(self, tick: int, now_ns: int, safe_V: float) -> float:
        """Voltage for this tick [V]; moves the state machine along."""
        supervisor, segment = self._supervisor, self.segment
        self.due_reference_N = nan
        if segment is None or not supervisor.driving or supervisor.state is State.RAMP_DOWN or supervisor.suspicious:
            return safe_V
        if supervisor.blind:
            return self._limiter.applied_V
        if supervisor.state is State.ARMING and not self._approaching:
            planned_V = self._prepare(segment, tick, now_ns)
            if not isnan(planned_V):
                return planned_V
            self._approaching = True
            segment.reference.start(tick)
        return self._follow(segment, tick, now_ns, safe_V)

    def _prepare(self, segment: Segment, tick: int, now_ns: int) -> float:
        """Sign check, then reset cycle [V]; nan when both are over."""
        if self._probing and self._sign_check is not None:
            wish_V = self._sign_check.wish(self._limiter.applied_V)
            if not self._sign_check.done:
                return wish_V
            self._probing = False
            if segment.reset_cycle is not None:
                segment.reset_cycle.start(tick)
        if self._cycling and segment.reset_cycle is not None:
            voltage_V = segment.reset_cycle.read(tick, now_ns)
            if segment.reset_cycle.freshness is Freshness.LIVE:
                return voltage_V
            self._cycling = False
        return nan

    def _follow(self, segment: Segment, tick: int, now_ns: int, safe_V: float) -> float:
        """Plan for the reference; while the first one is approached the reference stands at its start."""
        supervisor, reference = self._supervisor, segment.reference
        if supervisor.state is State.ARMING:
            reference.start(tick)
        value = reference.read(tick, now_ns)
        if reference.freshness is Freshness.LIVE:
            supervisor.resume()
            self.reference = value
            planned_V = segment.compensator.plan(reference.ahead)
            if supervisor.state is State.ARMING and self._is_reached(planned_V):
                supervisor.reached()
            if segment.follows_force and supervisor.state is State.RUNNING:
                self.due_reference_N = value
            return planned_V
        if supervisor.state is State.ARMING and reference.freshness is Freshness.STALE:
            return self._limiter.applied_V
        lapse = Cause.REFERENCE_ENDED if reference.freshness is Freshness.ENDED else Cause.REFERENCE_STALE
        if reference.ramp_down_on_lapse:
            supervisor.stop(lapse)
            return safe_V
        supervisor.hold(lapse)
        return self._limiter.applied_V

    def _is_reached(self, planned_V: float) -> bool:
        limiter = self._limiter
        return abs(limiter.nearest(planned_V) - limiter.applied_V) <= self._approach_V
