"""Every row of a control process, and what it sent, checked against the table `piezod/control/states.py`.

Between two rows the states must be joined by transitions of the table, the last of them by an event of the noted cause.
A voltage that was sent between the two rows must be allowed in one of the states in between. The rows are those that
the loop logs. The voltages are read from the bytes at the service's end of the wire, before anything happens to them.
"""

import struct

from piezod.control import Cause, State
from piezod.control.states import MAY_WRITE, TRANSITIONS, Event, Write

MOST_STEPS = 4  # events between two rows: two commands of a client, a fault, and its end
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
    """What one control process logs and sends; `violate` is called with the text of each discrepancy."""

    def __init__(self, violate):
        self._violate = violate
        self._state, self._cause = State.DISARMED, Cause.NONE
        self._sent_V, self._last_V = [], None
        self.transitions = 0

    def send(self, data, framing):
        """Bytes on their way to the device."""
        begin = 7 if framing == "tcp" else 1
        function, at = data[begin], begin + (1 if data[begin] == 16 else 5)
        if function in (16, 23) and int.from_bytes(data[at : at + 2], "big") == SET_POINT:
            self._sent_V.append(struct.unpack_from(">f", data, at + 5)[0])

    def add(self, tick, state, cause):
        """A row of the log."""
        state, cause, sent_V = State(state), Cause(cause), self._sent_V
        path = [self._state]
        if (state, cause) != (self._state, self._cause):
            path = self._path(state, cause)
            self.transitions += len(path or ()) - 1
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
