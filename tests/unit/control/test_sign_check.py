"""The sign check in the loop: the step before the approach, and the fault without a rise of the force."""

import numpy as np
import pytest

from piezod.config.sections import SignCheckConfig
from piezod.control import Cause, ControlLoop, Segment, State, TableReference
from tests.unit.control.fake_bench import FakeClock, FakeLink
from tests.unit.control.loops import DT_S, Halving, rows_of
from tests.unit.control.test_limits import limits

SIGN_CHECK = SignCheckConfig(step_V=2.0, rise_N=1.0, settle_s=0.02)


def test_the_sign_check_steps_up_and_back_before_the_approach(tmp_path, ring_log):
    link = FakeLink()
    loop = ControlLoop(link, limits(), FakeClock(), ring_log, DT_S, 200.0, sign_check=SIGN_CHECK)
    assert loop.drive(Segment("work", TableReference(np.full(10, 10.0)), Halving())) is Cause.NONE
    rows = rows_of(tmp_path)
    voltages = rows[rows["state"] == State.ARMING]["voltage_V"]
    assert set(voltages[:20]) == {0.0}
    assert voltages[20:50].max() == pytest.approx(2.0)
    back = 50 + int(np.flatnonzero(voltages[50:] < 0.25)[0])
    assert voltages[:back].max() == pytest.approx(2.0)
    assert np.abs(np.diff(voltages)).max() <= 0.2 + 1e-9


@pytest.mark.parametrize(
    "plant",
    [
        lambda voltage_V: -2.0 * voltage_V,  # wrong polarity of load cell or stack
        lambda voltage_V: 0.0,  # broken cable
        lambda voltage_V: 0.4 * voltage_V,  # too little preload
    ],
)
def test_a_force_that_does_not_rise_with_the_step_is_a_latched_fault_and_ends_the_drive(ring_log, plant):
    link = FakeLink(plant)
    loop = ControlLoop(link, limits(), FakeClock(), ring_log, DT_S, 200.0, sign_check=SIGN_CHECK)
    assert loop.drive(Segment("work", TableReference(np.full(10, 10.0)), Halving())) is Cause.SIGN_CHECK
    assert loop.supervisor.state is State.FAULT
    assert max(link.voltages) == pytest.approx(2.0)
    assert link.voltages[-1] == pytest.approx(0.0, abs=1e-9)
