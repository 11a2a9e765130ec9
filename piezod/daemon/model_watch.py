"""Comparison of a session with its model: drift of the bench, and cost of a live reference. Runs in the daemon."""

import asyncio
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, model_path
from piezod.daemon.drift import DriftWatch
from piezod.daemon.journal import log_line
from piezod.daemon.preview import MissingPreview, missing_preview
from piezod.errors import PiezodError
from piezod.session.assembly import load_drivable_model


class ModelWatch:
    """Compares one session after the other with its model.

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
    last_drift
        Result of the comparison of the session that ended last.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._waiting: list[NDArray[np.void]] = []
        self._loading: asyncio.Task[None] | None = None
        self.drift: DriftWatch | None = None
        self.preview: MissingPreview | None = None
        self.last_drift: dict[str, object] | None = None

    def begin(self, bench: BenchConfig) -> None:
        """Begin a new session; without a section `drift` nothing is compared.

        Parameters
        ----------
        bench
            Bench configuration of the session.
        """
        if bench.drift is None:
            return
        self._waiting = []
        self._loading = asyncio.get_running_loop().create_task(self._load(bench))

    def add(self, rows: NDArray[np.void]) -> None:
        """Compare new rows of the ring log."""
        if self.drift is not None:
            self._compare(self.drift, rows)
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
        self.drift = None

    async def _load(self, bench: BenchConfig) -> None:
        try:
            watch = await asyncio.to_thread(self._make_drift_watch, bench)
        except PiezodError as error:
            log_line(f"drift: not watched: {error}")
            self._waiting = []
            return
        self.drift = watch
        for rows in self._waiting:
            self._compare(watch, rows)
        self._waiting = []

    def _make_drift_watch(self, bench: BenchConfig) -> DriftWatch:
        """Load the model and the compiled steps; runs in a thread."""
        model = load_drivable_model(model_path(bench, self._path))
        self.preview = missing_preview(bench, model)
        watch = DriftWatch(bench, model, log_line)
        watch.warm_up()
        return watch

    def _compare(self, watch: DriftWatch, rows: NDArray[np.void]) -> None:
        watch.add(rows)
        if self.preview is not None:
            self.preview.add(rows)
