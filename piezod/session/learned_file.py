"""The file of a learned correction: written after every pass, read when a control process starts."""

import hashlib
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, model_path
from piezod.config.run_time_files import FILE_MODE, is_own_file, set_access
from piezod.control import TableReference
from piezod.errors import PiezodError
from piezod.recording import Recording, read_csv, write_csv

MAGIC = b"\n# learned: correction of a looped reference\n"
HEAD_BYTES = 4096
MOST_PART = 0.25
"""Default bound of the correction, as a part of the span of the reference: above, the model does not fit the bench."""
ROUNDED = 1.0 + 1e-6  # the file has nine digits
_COLUMN = "correction_N"


def most_N(bench: BenchConfig, table: TableReference) -> float:
    """Largest correction [N].

    Parameters
    ----------
    bench
        Bench configuration with a section `learning`.
    table
        Reference of the bench.
    """
    low, high = table.span()
    assert bench.learning is not None
    return bench.learning.most_N or MOST_PART * (high - low)


class LearnedFile:
    """The file of one bench, and what a correction in it must belong to: reference, model and compensation.

    Parameters
    ----------
    bench, path
        Bench configuration with a section `learning`, and its file.
    table
        Reference of the bench.

    Attributes
    ----------
    path
        The file: `learning.file`, or a file beside the ring log.
    problem
        Why the file could not be read or written; empty without a failure.
    """

    def __init__(self, bench: BenchConfig, path: Path, table: TableReference) -> None:
        self.path, self.problem = bench.learned_path, ""
        self._most_N = most_N(bench, table)
        self._name, self._dt_s, self._reference_N = bench.name, bench.dt_s, table.values()
        digest = hashlib.sha256(model_path(bench, path).read_bytes())
        digest.update(self._reference_N.tobytes())
        digest.update(repr((bench.rate_Hz, bench.compensation, bench.compensation_without)).encode())
        self._digest = digest.hexdigest()

    def read(self) -> NDArray[np.float64] | None:
        """Correction of an earlier run, shape (N,) [N]; None where there is none, or `problem` is why."""
        if not self.path.exists():
            return None
        try:
            recording = read_csv(self.path)
            if recording.metadata.get("digest") == self._digest:
                values = recording.channel(_COLUMN)
                if values.shape == self._reference_N.shape and (np.abs(values) <= self._most_N * ROUNDED).all():
                    return values
            self.problem = f"{self.path} belongs to another reference, model or bound"
        except PiezodError as error:
            self.problem = str(error)
        return None

    def write(self, correction_N: NDArray[np.float64]) -> None:
        """Replace the file; an error is noted in `problem`.

        Parameters
        ----------
        correction_N
            Correction, shape (N,) [N].
        """
        time_s = np.arange(correction_N.size, dtype=np.float64) * self._dt_s
        metadata = {"bench": self._name, "learned": "correction of a looped reference", "digest": self._digest}
        columns = {"reference_N": self._reference_N, _COLUMN: correction_N}
        try:
            is_own_file(self.path, "learning.file", MAGIC, HEAD_BYTES)
            write_csv(Recording(time_s, columns, metadata=metadata), self.path)
            set_access(self.path, FILE_MODE, os.getegid())
            self.problem = ""
        except (PiezodError, OSError) as error:
            self.problem = str(error)


def check_learned_file(bench: BenchConfig) -> None:
    """Refuse a file that is not a learned correction: it would be replaced.

    Parameters
    ----------
    bench
        Bench configuration.

    Raises
    ------
    ConfigurationError
        `learning.file` names another file.
    """
    if bench.learning is not None:
        is_own_file(bench.learned_path, "learning.file", MAGIC, HEAD_BYTES)
