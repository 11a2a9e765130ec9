"""Tasks on this machine, or for the workers of a Dask cluster: contents of files are sent, no disk is shared."""

import importlib
import logging
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from typing import Any

from piezod.diagnose.hypothesis.parallel import core_count
from piezod.errors import ConfigurationError, UnreachableError, UsageError
from piezod.tasks.isolated import ATTEMPTS, run_isolated, run_locally
from piezod.tasks.task import Outcome, TaskSource, failed_outcome

CONNECT_S = 5.0  # longest time for the scheduler to answer [s]
PATIENCE_S = 30.0  # longest time until a first worker is present [s]
SUBMITTED_PER_THREAD = 2
"""Tasks submitted per thread of the cluster: no thread is idle, and the scheduler stores few tasks."""


@contextmanager
def run_tasks(source: TaskSource, jobs: int | None, scheduler: str | None) -> Iterator[Iterator[Outcome]]:
    """Outcomes of tasks, each when it is complete; the end of the context ends the tasks that still run.

    Parameters
    ----------
    jobs
        Number of processes on this machine, at least 1; None: one per core.
    scheduler
        Address of a Dask scheduler; None: this machine.

    Raises
    ------
    ConfigurationError, UsageError, UnreachableError
        As for `run_on_cluster`.
    """
    outcomes = run_locally(source, jobs or core_count()) if scheduler is None else run_on_cluster(source, scheduler)
    with closing(outcomes):
        yield outcomes


def run_on_cluster(source: TaskSource, address: str, patience_s: float = PATIENCE_S) -> Generator[Outcome, None, None]:
    """Run tasks on a cluster and yield each outcome when it is complete.

    A task whose worker dies is tried again; the scheduler's option `allowed-failures` limits the attempts.

    Parameters
    ----------
    address
        Address of the scheduler, such as `tcp://10.0.0.1:8786`.
    patience_s
        Longest time to wait for a worker [s], above 0; the scheduler must answer within it too.

    Raises
    ------
    ConfigurationError
        `distributed` is not installed.
    UsageError
        The address is invalid.
    UnreachableError
        No scheduler answers, it has no worker, or the connection to it is lost.
    """
    distributed = _library()
    with _client(distributed, address, patience_s) as client:
        submitted = distributed.as_completed(loop=client.loop)
        names: dict[str, str] = {}

        def submit() -> Iterator[Outcome]:
            """Submit further tasks; yield the outcomes of tasks that failed before they began."""
            threads = sum(client.nthreads().values())
            most = max(SUBMITTED_PER_THREAD * threads, 1)
            while len(names) < most and (task := source()) is not None:
                if isinstance(task, Outcome):
                    yield task
                    continue
                future = client.submit(run_isolated, task, pure=False, retries=ATTEMPTS - 1)
                names[future.key] = task.name
                submitted.add(future)

        yield from submit()
        for future in submitted:
            yield _outcome(future, names.pop(future.key), address)
            yield from submit()


def _library() -> Any:  # noqa: ANN401  # an optional library
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise ConfigurationError("--scheduler: needs distributed; pip install 'piezod-bench[cluster]'") from error


@contextmanager
def _client(distributed: Any, address: str, patience_s: float) -> Iterator[Any]:  # noqa: ANN401  # as above
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # its log of many lines becomes one error line
    try:
        distributed.comm.resolve_address(address)  # early: a client with an invalid address takes a minute to close
        client = distributed.Client(address, timeout=min(patience_s, CONNECT_S), set_as_default=False)
    except OSError as error:
        raise UnreachableError(
            f"--scheduler is {address}: no scheduler answers there ({error}); start one with dask scheduler"
        ) from error
    except (ValueError, TypeError) as error:
        raise UsageError(f"--scheduler is '{address}', must be like tcp://HOST:8786: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=patience_s)
        except TimeoutError as error:
            raise UnreachableError(
                f"--scheduler is {address}: has no worker within {patience_s:g} s; start some with dask worker"
            ) from error
        yield client


def _outcome(future: Any, name: str, address: str) -> Outcome:  # noqa: ANN401  # of an optional library
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    if future.status == "cancelled":
        raise UnreachableError(f"--scheduler is {address}: connection lost; run the same command again to continue")
    error = future.exception()
    return failed_outcome(name, f"{type(error).__name__} on the cluster: {error}")
