"""The file of a learned correction: written after every pass, read when a control process starts."""

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig
from piezod.control import TableReference
from piezod.errors import PiezodError
from piezod.recording import Recording, read_csv
from piezod.session.files import files_digest
from piezod.session.kept_csv import KeptCsv

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
    """
    low, high = table.span()
    assert bench.learning is not None
    return bench.learning.most_N or MOST_PART * (high - low)


class LearnedFile:
    """The file of a bench, for corrections with its reference, model and compensation.

    Parameters
    ----------
    bench, path
        Bench configuration with a section `learning`, and its file.

    Attributes
    ----------
    path
        The file: `learning.file`, or a file next to the ring log.
    problem
        Why the file could not be read or written; empty without a failure.
    """

    def __init__(self, bench: BenchConfig, path: Path, table: TableReference) -> None:
        self._csv, self.problem = learned_file(bench), ""
        self.path = self._csv.path
        self._most_N = most_N(bench, table)
        self._name, self._dt_s, self._reference_N = bench.name, bench.dt_s, table.values()
        digest = hashlib.sha256(files_digest(bench, path).encode())
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
        metadata = {"bench": self._name, "digest": self._digest}
        columns = {"reference_N": self._reference_N, _COLUMN: correction_N}
        self.problem = self._csv.write(Recording(time_s, columns, metadata))


def learned_file(bench: BenchConfig) -> KeptCsv:
    """File of a learned correction: `learning.file`, or a file next to the ring log."""
    return KeptCsv(bench.learned_path, "learning.file", ("learned", "correction of a looped reference"))
