"""Timing figures of a session's rows."""

import numpy as np

from piezod.control import ROW_DTYPE, State
from piezod.session.history import History


def test_timing_counts_every_tick_that_wrote_a_voltage_and_no_other():
    rows = np.zeros(10, ROW_DTYPE)
    rows["state"] = [
        State.DISARMED,
        State.ARMING,
        *[State.RUNNING] * 4,
        State.HOLD,
        State.RAMP_DOWN,
        *[State.FAULT] * 2,
    ]
    rows["lateness_ns"] = np.arange(10) * 1000
    rows["exchange_ns"] = 500
    history = History()
    history.add(rows)
    found = history.timing()
    assert found.ticks == 7
    assert found.lateness_us["max"] == 7.0
    assert found.completion_us["max"] == 7.5
