"""What every file format offers: named columns in chunks. And what all of them need: limits, extras, whole files."""

import importlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError
from piezod.recording.names import TIME
from piezod.recording.recording import Recording

Array = NDArray[np.float64]
Table = dict[str, Array]

MOST_VALUES = 2**29
"""Numbers that one recording may hold: 4.3 GB as float64."""

VALUES_PER_BYTE = 1000
"""Numbers that a byte of a compressed file may stand for, beyond the first million: deflate packs 129."""

MANY = 1_000_000


@dataclass(frozen=True)
class Source:
    """An open recording file.

    Parameters
    ----------
    path
        The file.
    names
        Its columns, `time_s` among them.
    chunks
        Called with column names and a number of samples: yields tables of those columns in order; that many samples
        each, or as many as come easily.
    samples
        Length of the columns as the file claims it; None where only reading to the end tells.
    metadata
        What the file says about itself.
    """

    path: Path
    names: tuple[str, ...]
    chunks: Callable[[Sequence[str], int], Iterator[Table]]
    samples: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a size that no such file can hold, before anything is allocated."""
        if self.samples is not None:
            check_claim(self.path, self.samples * len(self.names))


def whole(source: Source) -> Recording:
    """Everything that a file holds.

    Raises
    ------
    RecordingError
        It holds no samples, or they are no recording.
    """
    parts = list(source.chunks(source.names, 2**20))
    if not parts:
        raise RecordingError(f"{source.path}: has a header but no samples")
    # Column by column, the parts let go: at no time is everything there twice.
    columns = {name: np.concatenate([part.pop(name) for part in parts]) for name in source.names}
    return Recording(columns.pop(TIME), columns, source.metadata, str(source.path))


def check_claim(path: Path, values: int) -> None:
    """Refuse a file that claims more numbers than its size or this program allows.

    Raises
    ------
    RecordingError
        The claim, and the limit.
    """
    limit = min(MOST_VALUES, MANY + VALUES_PER_BYTE * path.stat().st_size)
    if not 0 <= values <= limit:
        raise RecordingError(f"{path}: claims {values:.3g} numbers, a file of its size may hold {limit:.3g}")


def one_length(path: Path, lengths: dict[str, int]) -> int:
    """Length that all columns have.

    Raises
    ------
    RecordingError
        Two that differ, and the lengths they have.
    """
    first = next(iter(lengths), "")
    for name, length in lengths.items():
        if length != lengths[first]:
            raise RecordingError(f"{path}: {name} has {length} samples, {first} has {lengths[first]}; must be the same")
    return lengths.get(first, 0)


def spans(samples: int, chunk: int) -> Iterator[tuple[int, int]]:
    """(start, stop) of chunk after chunk, the last one shorter."""
    for start in range(0, samples, chunk):
        yield start, min(start + chunk, samples)


def skipped(left_out: Sequence[str]) -> dict[str, str]:
    """Metadata that says which parts of a file hold no numbers and were left out."""
    return {"skipped": ", ".join(left_out)[:500]} if left_out else {}


def require(module: str, extra: str, path: Path) -> Any:  # noqa: ANN401  a module without type information
    """Import the library of a format when a file of it is met; the daemon never carries it.

    Raises
    ------
    RecordingError
        It is not installed: what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise RecordingError(f"{path}: needs {package}; pip install 'piezod-bench[{extra}]'") from error


@contextmanager
def foreign(path: Path, task: str) -> Iterator[None]:
    """Turn whatever a library raises on a bad file into one line that names the file."""
    try:
        yield
    except RecordingError:
        raise
    except Exception as error:  # on damaged files the libraries raise anything: struct.error, KeyError, ...
        said = (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
        said = " ".join(said.split())[:200] or type(error).__name__
        raise RecordingError(f"{path}: cannot be {task}: {said}") from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file beside `path` to write to; takes its place when all went well, and is gone when not."""
    temporary = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        with foreign(path, "written"):
            yield temporary
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
