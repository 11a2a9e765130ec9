"""The simulation itself: equal histories of a seed, and a judge that sees what is wrong."""

import pytest

from tests.simulation.plan import Event, Plan, draw
from tests.simulation.runs import run


@pytest.mark.parametrize("seed", [1, 10, 1040])
def test_a_seed_has_one_history(seed):
    first, second = run(draw(seed, 6.0)), run(draw(seed, 6.0))
    assert first.violations == []
    assert first.digest == second.digest
    assert first.ticks == second.ticks > 0


def test_another_seed_has_another_history():
    assert run(draw(1, 5.0)).digest != run(draw(2, 5.0)).digest


def test_a_service_drives_after_arm_and_rests_after_disarm():
    result = run(Plan(1, 6.0, events=(Event(2.0, "arm"), Event(4.0, "disarm"))))
    assert result.violations == []
    states = [line.split(": ")[1] for line in result.log if line.split(": ")[1].isupper()]
    assert states == ["ARMING", "RUNNING", "RAMP_DOWN", "DISARMED"]
    assert 200 <= result.ticks <= 500  # two seconds of driving at 200 Hz, and the ramp down


def test_an_amplifier_that_stays_on_after_a_kill_is_a_violation():
    """Without its watchdog the device holds the output when the service is killed."""
    events = (Event(2.0, "arm"), Event(3.0, "watchdog", (0,)), Event(3.001, "kill_all"))
    result = run(Plan(1, 8.0, events=events))
    assert [kind for kind, *_ in result.violations] == ["rest"]
