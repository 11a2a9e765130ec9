"""The files of a bench, read in a process of their own with a time limit.

A dead mount, a slow disk or a large file then delays neither the event loop nor a stop.
"""

import asyncio
import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piezod.config import BenchConfig
from piezod.errors import PiezodError, TemporaryError, system_error_text
from piezod.runtime import processes
from piezod.session.assembly import correction_size, load_bench_and_model
from piezod.session.files import files_digest
from piezod.session.session import rebuild_error

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

READ_WITHIN_S = 20.0  # longest time of reading [s]; the largest reference file takes less on a slow disk


@dataclass(frozen=True)
class BenchFiles:
    """Content of the files of a bench.

    Parameters
    ----------
    bench
        Bench configuration, checked with its model.
    digest
        Digest of model and reference (`session/files.py`).
    correction_size
        Number of values of a learned correction; 0: nothing is learned.
    """

    bench: BenchConfig
    digest: str
    correction_size: int


async def read_bench_files(path: Path, within_s: float = READ_WITHIN_S) -> BenchFiles:
    """Read bench configuration, model and reference in a child process.

    Parameters
    ----------
    within_s
        Time limit [s]; then the child process is killed.

    Raises
    ------
    PiezodError
        A file is wrong.
    TemporaryError
        The time limit is over.
    """
    loop, arrived = asyncio.get_running_loop(), asyncio.Event()
    context = processes.spawn_context()
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_read, args=(path, theirs), daemon=True)
    process.start()
    theirs.close()
    loop.add_reader(ours.fileno(), arrived.set)
    try:
        async with asyncio.timeout(within_s):
            await arrived.wait()
        kind, content = ours.recv()
    except TimeoutError:
        raise TemporaryError(
            f"{path}: bench, model and reference were not read within {within_s:g} s; check their disk"
        ) from None
    except (EOFError, OSError):
        raise TemporaryError(f"{path}: the process that read it has ended; try again") from None
    finally:
        loop.remove_reader(ours.fileno())
        ours.close()
        process.kill()
    if kind == "error":
        raise rebuild_error(*content)
    result: BenchFiles = content
    return result


def load_bench_files(path: Path) -> BenchFiles:
    """Read bench configuration, model and reference in this process.

    Raises
    ------
    PiezodError
        A file is wrong.
    """
    bench, _ = load_bench_and_model(path)
    return BenchFiles(bench, files_digest(bench, path), correction_size(bench, path.parent))


def _read(path: Path, pipe: "Connection") -> None:
    answer: tuple[str, Any]
    try:
        answer = "read", load_bench_files(path)
    except PiezodError as error:
        answer = "error", (type(error).__name__, str(error))
    except OSError as error:
        answer = "error", (TemporaryError.__name__, system_error_text(error))
    with contextlib.suppress(BrokenPipeError):  # the daemon has ended meanwhile
        pipe.send(answer)
