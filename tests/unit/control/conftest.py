"""Fixtures of the tests of the control loop."""

import pytest

from piezod.control import RingLog


@pytest.fixture
def ring_log(tmp_path):
    ring_log = RingLog(tmp_path / "ring", 10_000)
    yield ring_log
    ring_log.close()
