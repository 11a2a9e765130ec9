"""A short run of the state machine; `python -m tests.stateful` is the long one."""

import pytest

from tests.stateful.run import open_service, run_chunk

pytestmark = pytest.mark.real_time
SEQUENCES, STEPS, SEED = 8, 10, 17


def test_no_random_sequence_violates_the_safety_of_the_amplifier():
    with open_service() as service:
        failures = run_chunk(service, SEQUENCES, STEPS, SEED)
        assert service.sequences >= SEQUENCES
    assert failures == []
