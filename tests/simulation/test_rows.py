"""The rows of the fault list that run in virtual time."""

import pytest

from tests.simulation.rows import rows, run_row
from tests.simulation.runs import warm_up

ROWS = rows()
LEAST = 32


@pytest.fixture(scope="module", autouse=True)
def _warm():
    warm_up()


@pytest.mark.parametrize("name", ROWS)
def test_row_has_its_expected_result(name):
    bad, _ = run_row(ROWS[name])
    assert bad == []


def test_no_row_is_lost():
    assert len(ROWS) >= LEAST
