"""What the daemon does with the model beside a session: drift, learning, and the cost of a live reference."""

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, model_path
from piezod.control.references.repeat_correction import RepeatCorrection
from piezod.daemon.drift import DriftWatch
from piezod.daemon.journal import log_line
from piezod.daemon.learning_watch import LearningWatch
from piezod.daemon.preview import MissingPreview, missing_preview
from piezod.errors import PiezodError
from piezod.session.assembly import load_drivable_model


class ModelWatch:
    """Compares one session after the other with its model, and learns from its repeats.

    A thread loads the model of a session. Rows that arrive before it is loaded are compared afterwards.

    Parameters
    ----------
    path
        Bench configuration, which names the model.

    Attributes
    ----------
    drift
        Comparison of the present session; None before its model is loaded, or without a section `drift`.
    preview
        Cost of a live reference; None where it has none.
    learning
        Learning of the present session; None before its model is loaded, or without a section `learning`.
    last_drift
        Result of the comparison of the session that ended last.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._waiting: list[NDArray[np.void]] = []
        self._loading: asyncio.Task[None] | None = None
        self.drift: DriftWatch | None = None
        self.preview: MissingPreview | None = None
        self.learning: LearningWatch | None = None
        self.last_drift: dict[str, object] | None = None

    def begin(self, bench: BenchConfig, correction: Any = None) -> None:  # noqa: ANN401  # an array of ctypes
        """Begin a new session; without sections `drift` and `learning` nothing is loaded.

        Parameters
        ----------
        correction
            Shared memory of a learned correction; None: nothing is learned.
        """
        if bench.drift is None and correction is None:
            return
        self._waiting = []
        self._loading = asyncio.get_running_loop().create_task(self._load(bench, correction))

    def add(self, rows: NDArray[np.void]) -> None:
        """Compare new rows of the ring log."""
        if self.drift is not None or self.learning is not None:
            self._compare(rows)
        elif self._loading is not None and not self._loading.done():
            self._waiting.append(rows)

    async def end(self) -> None:
        """End the session; the recording of a drift is on the disk when this returns."""
        if self._loading is not None:
            await self._loading
        self._loading = None
        if self.drift is not None:
            await asyncio.to_thread(self.drift.close)
            self.last_drift = self.drift.as_dict()
        self.drift = self.learning = None

    async def _load(self, bench: BenchConfig, correction: Any) -> None:  # noqa: ANN401  # an array of ctypes
        try:
            drift, learning = await asyncio.to_thread(self._make_watches, bench, correction)
        except PiezodError as error:
            log_line(f"drift and learning: off: {error}")
            self._waiting = []
            return
        self.drift, self.learning = drift, learning
        for rows in self._waiting:
            self._compare(rows)
        self._waiting = []

    def _make_watches(
        self,
        bench: BenchConfig,
        correction: Any,  # noqa: ANN401  # an array of ctypes
    ) -> tuple[DriftWatch | None, LearningWatch | None]:
        """Load the model and the compiled steps; runs in a thread."""
        model = load_drivable_model(model_path(bench, self._path))
        drift = learning = None
        if bench.drift is not None:
            self.preview = missing_preview(bench, model)
            drift = DriftWatch(bench, model, log_line)
            drift.warm_up()
        if correction is not None:
            learning = LearningWatch(bench, self._path, model, RepeatCorrection(correction), log_line)
            learning.warm_up()
        return drift, learning

    def _compare(self, rows: NDArray[np.void]) -> None:
        if self.drift is not None:
            self.drift.add(rows)
        if self.learning is not None:
            self.learning.add(rows)
        if self.preview is not None:
            self.preview.add(rows)
