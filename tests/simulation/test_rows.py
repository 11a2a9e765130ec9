"""The rows of the fault list that run in virtual time."""

import pytest

from tests.simulation.rows import phases, rows, run_row
from tests.simulation.runs import warm_up

ROWS = rows()
LEAST = 118
SMALL = {"by": "running", "changes": {"link": {"setpoint_readable": False}},
         "steps": [{"second_master": {"above_V": 4.5, "times": 60, "every_s": 0.002}}]}  # fmt: skip
"""P39 with voltages that are nearer to those of the daemon."""


@pytest.fixture(scope="module", autouse=True)
def _warm():
    warm_up()


@pytest.mark.parametrize(("name", "fault_s"), [(name, at_s) for name, row in ROWS.items() for at_s in phases(row)])
def test_row_has_its_expected_result(name, fault_s):
    bad, _ = run_row(ROWS[name], fault_s)
    assert bad == []


@pytest.mark.parametrize("fault_s", [3.0, 5.5, 8.0, 10.5])
def test_readback_alone_finds_a_second_master_outside_the_voltages_of_the_last_tenth_of_a_second(fault_s):
    """4.5 V above a voltage that moves by at most 1.1 V in 0.1 s exceed `readback_trip_V`, 3 V, at every phase."""
    bad, _ = run_row(ROWS["P39"] | {"inject": SMALL}, fault_s, frequency_Hz=0.1)
    assert bad == []


def test_readback_alone_misses_a_second_master_within_the_voltages_of_the_last_tenth_of_a_second():
    """While the voltage falls by 14 V in 0.1 s, 4.5 V more are among its own voltages: the bound in the README."""
    bad, _ = run_row(ROWS["P39"] | {"inject": SMALL}, 3.0)
    assert "state RUNNING, not FAULT" in bad


def test_no_row_is_lost():
    assert len(ROWS) >= LEAST
