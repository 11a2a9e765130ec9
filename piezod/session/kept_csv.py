"""CSV files that the daemon replaces; it never replaces a file of another origin."""

import os
from dataclasses import dataclass
from pathlib import Path

from piezod.config.run_time_files import FILE_MODE, is_own_file, set_access
from piezod.errors import PiezodError
from piezod.recording import Recording, write_csv

HEAD_BYTES = 4096


@dataclass(frozen=True)
class KeptCsv:
    """A file with a mark of its own in the metadata.

    Parameters
    ----------
    key
        Key of the bench file that names it, for messages.
    mark
        Key and value of the metadata that every such file has.
    """

    path: Path
    key: str
    mark: tuple[str, str]

    def check(self) -> None:
        """Refuse another file at this path: it would be replaced.

        Raises
        ------
        ConfigurationError
            Something that the daemon did not make is there.
        """
        is_own_file(self.path, self.key, "\n# {}: {}\n".format(*self.mark).encode(), HEAD_BYTES)

    def write(self, recording: Recording) -> str:
        """Replace the file; the result is why it failed, empty without an error.

        Parameters
        ----------
        recording
            Recording to write; the mark is added to its metadata.
        """
        marked = dict(recording.metadata) | dict([self.mark])
        try:
            self.check()
            write_csv(Recording(recording.time_s, dict(recording.channels), marked), self.path)
            set_access(self.path, FILE_MODE, os.getegid())
        except (PiezodError, OSError) as error:
            return str(error)
        return ""
