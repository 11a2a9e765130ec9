"""Every row of a control process, and what it sent, checked against the table `piezod/control/states.py`.

Between two rows the states must be joined by transitions of the table, the last of them by an event of the noted cause.
A voltage that was sent between the two rows must be allowed in one of the states in between. The rows are those that
the loop logs. The voltages are read from the bytes at the service's end of the wire, before anything happens to them.

The rate of each ramp is checked against the order of authority (`piezod/control/authority.py`): never slower than the
demand that holds, and at the comfortable rate without haste. After a stop that was answered nothing drives for two
seconds.
"""

import signal
import struct

from piezod.control import Cause, State
from piezod.control.authority import Demand
from piezod.control.states import DANGERS, MAY_WRITE, TRANSITIONS, Event, Write
from piezod.session.task import URGENT

OUTRANKED_NS = 2_000_000_000  # an arm must not act for so long after a stop
LATE_ROWS = 2  # ticks that may still drive after the answer of a stop
LEEWAY_V = 0.02  # of a step: converter and rounding
AMPLIFIER_FAULTS = (Cause.DEVICE_FAULT, Cause.DEVICE_TOO_HOT, Cause.MAINS_LOST)
MOST_STEPS = 4  # events between two rows: two commands of a client, a fault, and its end
FAST_STOPS = {signal.SIGUSR2, URGENT["stop"]}
SET_POINT = 100  # address of the voltage register
EVENTS = {
    Cause.ARMED: (Event.ARM,),
    Cause.REFERENCE_REACHED: (Event.REACHED,),
    Cause.STOPPED: (Event.STOP, Event.LEFT),
    Cause.REFERENCE_ENDED: (Event.LAPSED, Event.STOP),
    Cause.REFERENCE_STALE: (Event.LAPSED, Event.STOP),
    Cause.REFERENCE_LIVE: (Event.LIVE,),
    Cause.ARMING_TIMEOUT: (Event.STOP,),
    Cause.SAFE: (Event.AT_REST,),
    Cause.RESET: (Event.RESET,),
}
FAULT = (Event.TRIP, Event.LATCHED)  # events of every other cause


class Trace:
    """What one control process logs and sends; `violate` is called with the text of each discrepancy.

    A slew limit, a comfortable rate [V/tick] and the length of a tick let it judge the rate of each ramp. `received` is
    the set of signals that have come to the process: those of a fast stop permit the slew limit.
    """

    def __init__(self, violate, slew_V=0.0, ramp_V=0.0, dt_ns=0, received=frozenset()):
        self._received = received
        self._violate, self._slew_V, self._ramp_V, self._dt_ns = violate, slew_V, ramp_V, dt_ns
        self._row = None  # tick, voltage, time and cause of the last good row of a ramp
        self.asked_ns = self.stopped_ns = None  # first stop that may act, and answer of the last one
        self._rows_after = 0  # rows since that answer
        self._state, self._cause = State.DISARMED, Cause.NONE
        self._sent_V, self._last_V = [], None
        self.transitions = 0

    def send(self, data, framing):
        """Bytes on their way to the device."""
        begin = 7 if framing == "tcp" else 1
        function, at = data[begin], begin + (1 if data[begin] == 16 else 5)
        if function in (16, 23) and int.from_bytes(data[at : at + 2], "big") == SET_POINT:
            self._sent_V.append(struct.unpack_from(">f", data, at + 5)[0])

    def stop(self, now_ns, *, answered):
        """A stop is sent to this process, or was answered."""
        self.asked_ns = now_ns if self.asked_ns is None else self.asked_ns
        if answered:
            self.stopped_ns, self._rows_after = now_ns, 0

    def judge_authority(self, row, now_ns):
        """A row of `ROW_DTYPE`: which demand holds, and whether the output obeys it."""
        tick, begun_ns, voltage_V, state, result, cause = *row[:2], row[4], State(row[10]), row[11], Cause(row[13])
        if self.asked_ns is not None and now_ns > self.asked_ns + OUTRANKED_NS and state is State.ARMING:
            self.asked_ns = self.stopped_ns = None
        self._rows_after += 1
        stopped = self.stopped_ns is not None and self._rows_after > LATE_ROWS
        if stopped and MAY_WRITE[state] in (Write.PLANNED, Write.HELD):
            self._violate(f"tick {tick}: {state.name}, {1e-9 * (now_ns - self.stopped_ns):.3f} s after a stop")
        good = self._dt_ns and state is State.RAMP_DOWN and result == 0 and cause not in AMPLIFIER_FAULTS
        if good and self._row is not None and self._row[0] == tick - 1:
            demand = Demand.STOP if stopped else Demand.DANGER if self._row[3] in DANGERS else Demand.FAULT
            fallen_V, left_V = abs(self._row[1]) - abs(voltage_V), abs(self._row[1])
            hasty = demand is not Demand.FAULT
            early = min(1.0, (begun_ns - self._row[2]) / self._dt_ns)  # after a late tick the next one is short
            least_V = min(early * (self._slew_V if hasty else self._ramp_V), left_V) - LEEWAY_V
            slow = not hasty and self.asked_ns is None and not self._received & FAST_STOPS
            most_V = (self._ramp_V if slow else self._slew_V) + LEEWAY_V
            if not least_V <= fallen_V <= most_V:
                self._violate(
                    f"tick {tick}: {fallen_V:.3f} V less by {demand.name}, must be {least_V:.3f} to {most_V:.3f}"
                )
        self._row = (tick, voltage_V, begun_ns, cause) if good else None

    def add(self, tick, state, cause):
        """A row of the log."""
        state, cause, sent_V = State(state), Cause(cause), self._sent_V
        path = [self._state]
        if (state, cause) != (self._state, self._cause):
            path = self._path(state, cause)
            self.transitions += len(path or " ") - 1
            if path is None:
                self._violate(f"tick {tick}: {self._state.name} -> {state.name} by {cause.name}: not in the table")
                path = [self._state, state]
        writes = {MAY_WRITE[one] for one in path}
        if sent_V and writes == {Write.NOTHING}:
            self._violate(f"tick {tick}: {sent_V[-1]:.3f} V sent in {state.name}, which writes nothing")
        for voltage_V in sent_V:
            self._judge(tick, state, voltage_V, writes)
            self._last_V = voltage_V
        self._state, self._cause, self._sent_V = state, cause, []

    def _judge(self, tick, state, voltage_V, writes):
        changed_V = 0.0 if self._last_V is None else voltage_V - self._last_V
        if (writes == {Write.LOWER} and changed_V > 0.0) or (writes == {Write.HELD} and changed_V):
            self._violate(f"tick {tick}: {self._last_V:.3f} V, then {voltage_V:.3f} V sent in {state.name}")

    def _path(self, state, cause):
        """Shortest states from the last one to `state`, the last step by an event of `cause`; None: there is none.

        An event that leaves the state notes no cause, except the first fault in RAMP_DOWN.
        """
        causes, paths = EVENTS.get(cause, FAULT), [[self._state]]
        for _ in range(MOST_STEPS):
            for path in paths:
                events = [event for event in causes if TRANSITIONS.get((path[-1], event)) is state]
                if (path[-1] is not state and events) or (Event.TRIP in events and state is State.RAMP_DOWN):
                    return [*path, state]
            steps = [(before, after) for (before, _), after in TRANSITIONS.items() if before is not after]
            paths = [[*path, after] for path in paths for before, after in steps if before is path[-1]]
        return None
