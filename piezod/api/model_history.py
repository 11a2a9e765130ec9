"""`piezod.history`: the models of a bench over time."""

import html
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezod.history.timeline import Timeline, timeline_of
from piezod.history.words import verdict_of
from piezod.report.history import history_rows, history_text, write_history_csv, write_history_page
from piezod.report.page import table_html

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


@dataclass(frozen=True)
class History:
    """Result of `piezod.history`."""

    timeline: Timeline

    @property
    def verdict(self) -> str:
        """Changes from model to model in a sentence."""
        return verdict_of(self.timeline)

    def as_dict(self) -> dict[str, Any]:
        """The history as `piezod history --json` prints it."""
        return self.timeline.as_dict(self.verdict)

    def write_page(self, path: str | os.PathLike[str]) -> None:
        """Write the page that `piezod history --output` writes."""
        write_history_page(Path(path), self.timeline)

    def write_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table that `piezod history --csv` writes."""
        write_history_csv(Path(path), self.timeline)

    def __str__(self) -> str:
        """Table, verdict and notes."""
        return history_text(self.timeline)

    def _repr_html_(self) -> str:
        header, *rows = history_rows(self.timeline)
        return f"<p><strong>{html.escape(self.verdict)}</strong></p>{table_html(header, rows)}"


def history(paths: Paths) -> History:
    """Order models by lineage and date, and compare each with its parent or with the model before it.

    Parameters
    ----------
    paths
        Model files and folders, one or several. Of a folder, the models in it and in its subfolders are read.

    Raises
    ------
    ConfigurationError, ModelError
        A file is no model or a broken one, or a folder holds no model.
    """
    some = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    return History(timeline_of([Path(path) for path in some]))
