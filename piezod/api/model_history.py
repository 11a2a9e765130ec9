"""`piezod.history`: the models of a bench over time."""

import html
import os
from collections.abc import Sequence
from dataclasses import dataclass

from piezod.api.arguments import path_of
from piezod.errors import UsageError
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

    def as_dict(self) -> dict[str, object]:
        """The history as `piezod history --json` prints it.

        Returns
        -------
        dict
            Numbers, texts and lists of them by name.

        Examples
        --------
        >>> piezod.history("model.yaml").as_dict()["schema"]
        'piezod.history/1'
        """
        return self.timeline.as_dict(self.verdict)

    def write_page(self, path: str | os.PathLike[str]) -> None:
        """Write the page that `piezod history --output` writes.

        Raises
        ------
        ConfigurationError
            The file cannot be written.
        UsageError
            The argument is no path.

        Examples
        --------
        >>> piezod.history("model.yaml").write_page("history.html")
        """
        write_history_page(path_of(path), self.timeline)

    def write_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table that `piezod history --csv` writes.

        Raises
        ------
        ConfigurationError
            The file cannot be written.
        UsageError
            The argument is no path.

        Examples
        --------
        >>> piezod.history("model.yaml").write_csv("history.csv")
        """
        write_history_csv(path_of(path), self.timeline)

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

    Returns
    -------
    History
        The models in their order, and the changes from model to model.

    Raises
    ------
    ConfigurationError, ModelError
        A file is no model or a broken one, or a folder holds no model.
    UsageError
        The argument is neither a path nor a list of paths, or no path is given.

    Examples
    --------
    >>> print(piezod.history("model.yaml").verdict)
    one model, nothing to compare it with
    """
    some = [paths] if not isinstance(paths, list | tuple) else paths
    if not some:
        raise UsageError("no model is given, must be at least one")
    return History(timeline_of([path_of(path, "paths") for path in some]))
