"""Cases judged by the workers of a Dask cluster: contents go there, contents come back, no disk is shared."""

import importlib
import logging
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from piezod.blind.case import read_case
from piezod.blind.isolated import ATTEMPTS, judge_apart
from piezod.blind.verdict import Verdict, failed_verdict
from piezod.errors import ConfigurationError, PiezodError, UnreachableError, UsageError

ANSWERS_S = 5.0  # that a scheduler may take to answer
PATIENCE_S = 30.0  # for a first worker to be there
AHEAD = 2  # cases a thread of the cluster has waiting, so that it never idles and the scheduler holds few


def judge_there(
    folders: Sequence[Path], address: str, patience_s: float = PATIENCE_S
) -> Generator[Verdict, None, None]:
    """Judge cases on a cluster; the verdicts come as they are ready.

    A worker that dies costs its case one attempt of a few (the scheduler's `allowed-failures`), then it has failed.

    Parameters
    ----------
    folders
        Of the cases.
    address
        Of the scheduler, such as `tcp://10.0.0.1:8786`.
    patience_s
        How long to wait for a worker, and at most for the scheduler [s].

    Raises
    ------
    ConfigurationError
        `distributed` is not installed.
    UsageError
        It is no address.
    UnreachableError
        No scheduler answers there, it has no worker, or it went away.
    """
    distributed = _library()
    with _client(distributed, address, patience_s) as client:
        waiting = distributed.as_completed(loop=client.loop)
        names: dict[str, str] = {}
        left = iter(folders)

        def hand_out() -> Iterator[Verdict]:
            """Keep the cluster busy; yield cases that cannot even be read."""
            threads = sum(client.nthreads().values())
            while len(names) < max(AHEAD * threads, 1) and (folder := next(left, None)) is not None:
                try:
                    case = read_case(folder)
                except PiezodError as error:
                    yield failed_verdict(folder.name, str(error))
                    continue
                future = client.submit(judge_apart, case, pure=False, retries=ATTEMPTS - 1)
                names[future.key] = case.name
                waiting.add(future)

        yield from hand_out()
        for future in waiting:
            yield _verdict(future, names.pop(future.key), address)
            yield from hand_out()


def _library() -> Any:  # noqa: ANN401  # an optional library
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise ConfigurationError("--scheduler: needs distributed; pip install 'piezod-bench[cluster]'") from error


@contextmanager
def _client(distributed: Any, address: str, patience_s: float) -> Iterator[Any]:  # noqa: ANN401  # as above
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what it tells in pages is told here in one line
    try:
        distributed.comm.resolve_address(address)  # a client that never began takes a minute to end
        client = distributed.Client(address, timeout=min(patience_s, ANSWERS_S), set_as_default=False)
    except OSError as error:
        raise UnreachableError(
            f"--scheduler is {address}: nobody answers there ({error}); start one with dask scheduler"
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


def _verdict(future: Any, name: str, address: str) -> Verdict:  # noqa: ANN401  # of an optional library
    if future.status == "finished":
        verdict: Verdict = future.result()
        return verdict
    if future.status == "cancelled":
        raise UnreachableError(f"--scheduler is {address}: went away; the same command goes on where this one stopped")
    error = future.exception()
    return failed_verdict(name, f"{type(error).__name__} on the cluster: {error}")
