"""Running sequences of the state machine on one service."""

import contextlib
import tempfile
from pathlib import Path

from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.errors import Flaky
from hypothesis.stateful import run_state_machine_as_test

from tests.faults.bench_pool import raised_priority
from tests.stateful.machine import ServiceMachine
from tests.stateful.service import LiveService

CHUNK = 50  # sequences of one seed


@contextlib.contextmanager
def open_service():
    """A service on a bench in a temporary folder."""
    with raised_priority(), tempfile.TemporaryDirectory(prefix="piezod-stateful-") as folder:
        service = LiveService(Path(folder) / "bench")
        try:
            yield service
        finally:
            service.close()


def run_chunk(service, sequences, steps, number):
    """Run sequences until one is violated.

    Parameters
    ----------
    service
        The service.
    sequences, steps
        Number of sequences, and of steps in each.
    number
        Seed.

    Returns
    -------
    Pairs of message and steps, of every sequence that was violated. A violation is repeated once; it counts as well
    when the repetition passes, because the clock of the machine is part of a sequence.
    """
    failures = []

    class Machine(ServiceMachine):
        def __init__(self):
            super().__init__()
            self.service = service

        def failed(self, message):
            failures.append((message, ["(the sequence before)", *service.before, "(this sequence)", *self.steps]))

    seed(number)(Machine)
    options = settings(
        max_examples=sequences,
        stateful_step_count=steps,
        deadline=None,
        database=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    try:
        run_state_machine_as_test(Machine, settings=options)
    except (Exception, Flaky) as error:
        if not failures:
            raise
        print(f"{type(error).__name__}")
    return failures
