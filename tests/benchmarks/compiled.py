"""The C sources of this folder, compiled into a temporary folder."""

import contextlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.benchmarks.table import NotMeasuredError

_HERE = Path(__file__).resolve().parent
_FLAGS = ("-O2", "-fno-fast-math", "-Wall")  # without reordered sums


@contextlib.contextmanager
def compiled(source: str | Path, *flags: str) -> Iterator[Path]:
    """Compile `source` with `flags` and yield the path of the result.

    Raises
    ------
    NotMeasuredError
        No compiler, or a library that the source needs is not installed.
    """
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise NotMeasuredError("no compiler")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / Path(source).stem
        command = [compiler, *_FLAGS, str(_HERE / source), "-o", str(target), *flags]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise NotMeasuredError(f"{source} does not compile: {done.stderr.strip().splitlines()[0]}")
        yield target
