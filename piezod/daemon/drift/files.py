"""Files of the drift watch: the recording of a bench that has drifted, and the known windows of its driving."""

import hashlib
from pathlib import Path

import numpy as np

from piezod.config import BenchConfig, load_bench, model_path
from piezod.daemon.drift.blocks import Cell
from piezod.daemon.drift.reference import STEP, STEPS, BlockReference
from piezod.errors import CheckFailedError, ConfigurationError, PiezodError
from piezod.model import Model, dump_model
from piezod.recording import Recording, read_csv
from piezod.session.kept_csv import KeptCsv

_CELL = ("low_quarter", "high_quarter", "rate_octave", "frequency_octave", "temperature_step")
_COLUMNS = (*_CELL, "distance_step", "windows")


class BlocksFile:
    """File of the known windows of a bench with one model, one rate and one length of a window.

    Parameters
    ----------
    bench
        Bench configuration with a section `drift`.

    Attributes
    ----------
    problem
        Why the file could not be read or written; empty without a failure.
    """

    def __init__(self, bench: BenchConfig, model: Model) -> None:
        assert bench.drift is not None
        self._csv, self.problem = blocks_file(bench), ""
        self._name = bench.name
        made_with = repr((dump_model(model), bench.rate_Hz, bench.drift.window_s, STEP, STEPS))
        self._digest = hashlib.sha256(made_with.encode()).hexdigest()

    def read_into(self, reference: BlockReference) -> None:
        """Insert the windows of the file, if it belongs to this bench and model."""
        if not self._csv.path.exists():
            return
        try:
            recording = read_csv(self._csv.path)
            if recording.metadata.get("digest") != self._digest:
                return
            rows = np.stack([recording.channel(name) for name in _COLUMNS], axis=1).astype(int)
        except PiezodError as error:
            self.problem = str(error)
            return
        for row in rows.tolist():
            reference.insert(Cell(*row[: len(_CELL)]), min(max(row[-2], 0), 2 * STEPS), max(row[-1], 0))

    def rows_of(self, reference: BlockReference) -> list[tuple[int, ...]]:
        """Rows of the file: kind of input, step of the distance, number of windows."""
        rows: list[tuple[int, ...]] = []
        for cell, counts in reference.counts.items():
            numbers = counts - np.append(counts[1:], 0)
            rows += [(*cell, int(step), int(numbers[step])) for step in np.flatnonzero(numbers)]
        return rows

    def write(self, rows: list[tuple[int, ...]]) -> None:
        """Replace the file; an error is noted in `problem`."""
        if not rows:
            return
        values = np.array(rows, dtype=np.float64)
        channels = {name: values[:, k] for k, name in enumerate(_COLUMNS)}
        metadata = {"bench": self._name, "digest": self._digest}
        self.problem = self._csv.write(Recording(np.arange(len(rows), dtype=np.float64), channels, metadata))


def blocks_file(bench: BenchConfig) -> KeptCsv:
    """File of the known windows: `drift.blocks`, or a file beside the ring log."""
    return KeptCsv(bench.blocks_path, "drift.blocks", ("kept", "windows of driving"))


def drift_file(bench: BenchConfig) -> KeptCsv:
    """File for the recording of a bench that has drifted: `drift.file`, or a file beside the ring log."""
    return KeptCsv(bench.drift_path, "drift.file", ("kept", "left its model"))


def find_drift_recording(path: Path) -> tuple[Path, Path]:
    """Find the recording of a bench that has drifted, and the model that it was compared with.

    Raises
    ------
    ConfigurationError
        The configuration has no section `drift`.
    CheckFailedError
        There is no such recording.
    """
    bench = load_bench(path)
    if bench.drift is None:
        raise ConfigurationError(f"{path}: drift is null, must be a section: no drift is watched, so none is recorded")
    recording = bench.drift_path
    if not recording.exists():
        raise CheckFailedError(
            f"{recording}: not there: this bench has not left its model; see piezod status, or name a recording"
        )
    return recording, model_path(bench, path)
