"""The emulated bench as a process of its own, started for the demo and ended with it."""

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from piezod.errors import UnreachableError


@contextlib.contextmanager
def emulated_bench(config: Path, *arguments: str) -> Iterator[dict[str, str]]:
    """Start `python -m firmware_sim`, yield what it serves (`tcp`, `rtu`, `line`), end it.

    Raises
    ------
    UnreachableError
        It did not come up.
    """
    command = [sys.executable, "-m", "firmware_sim", str(config), "--until-stdin-closes", *arguments]
    process = subprocess.Popen(  # noqa: S603  # our own interpreter and module
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        line = process.stdout.readline() if process.stdout else ""
        if not line:
            raise UnreachableError(f"the emulated bench did not start: {' '.join(command)} ended with {process.wait()}")
        yield json.loads(line)
    finally:
        process.terminate()
        try:
            process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for stream in (process.stdin, process.stdout):
            if stream:
                stream.close()
