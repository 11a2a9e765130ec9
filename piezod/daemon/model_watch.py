"""A session beside its model, in the parent: whether the bench has left it, and what a live reference costs."""

import asyncio
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, model_path
from piezod.daemon.drift import DriftWatch
from piezod.daemon.journal import say
from piezod.daemon.preview import MissingPreview, missing_preview
from piezod.errors import PiezodError
from piezod.session.assembly import load_drivable


class ModelWatch:
    """Follows one session after the other; until a session's model is loaded, in a thread, its rows wait.

    Parameters
    ----------
    path
        The configuration file, which says where the model is.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._waiting: list[NDArray[np.void]] = []
        self._preparing: asyncio.Task[None] | None = None
        self.drift: DriftWatch | None = None
        self.preview: MissingPreview | None = None
        self.last_drift: dict[str, object] | None = None  # of the session that ended last

    def begin(self, bench: BenchConfig) -> None:
        """A new session; nothing is compared where the configuration has no section `drift`."""
        if bench.drift is None:
            return
        self._waiting = []
        self._preparing = asyncio.get_running_loop().create_task(self._prepare(bench))

    def add(self, rows: NDArray[np.void]) -> None:
        """Take in new rows."""
        if self.drift is not None:
            self._compare(self.drift, rows)
        elif self._preparing is not None and not self._preparing.done():
            self._waiting.append(rows)

    async def end(self) -> None:
        """The next session may have another model; what was kept is on the disk then."""
        if self._preparing is not None:
            await self._preparing
        self._preparing = None
        if self.drift is not None:
            await asyncio.to_thread(self.drift.close)
            self.last_drift = self.drift.as_dict()
        self.drift = None

    async def _prepare(self, bench: BenchConfig) -> None:
        try:
            watch = await asyncio.to_thread(self._loaded, bench)
        except PiezodError as error:
            say(f"drift: not watched: {error}")
            self._waiting = []
            return
        self.drift = watch
        for rows in self._waiting:
            self._compare(watch, rows)
        self._waiting = []

    def _loaded(self, bench: BenchConfig) -> DriftWatch:
        """The model's watch, and the compiled steps with it."""
        model = load_drivable(model_path(bench, self._path))
        self.preview = missing_preview(bench, model)
        watch = DriftWatch(bench, model, say)
        watch.warm_up()
        return watch

    def _compare(self, watch: DriftWatch, rows: NDArray[np.void]) -> None:
        watch.add(rows)
        if self.preview is not None:
            self.preview.add(rows)
