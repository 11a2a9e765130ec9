"""One case as it is handed out: what an engineer would have, and nothing of the sealed truth.

A case travels as the contents of its files, so that whoever judges it needs no disk of ours.
"""

import json
import zlib
from dataclasses import dataclass
from pathlib import Path

from piezod.errors import ConfigurationError, UsageError

SEAL = "seal.json"
DESCRIPTION = "case.json"
SCHEMA = "firmware_sim.concealed.case/1"


@dataclass(frozen=True)
class Case:
    """A case on its way.

    Parameters
    ----------
    name
        Such as `case_0001`.
    files
        Compressed contents by the name of the file.
    """

    name: str
    files: dict[str, bytes]

    def unpack(self, folder: Path) -> None:
        """Write its files into a folder that is there."""
        for name, content in self.files.items():
            (folder / name).write_bytes(zlib.decompress(content))


@dataclass(frozen=True)
class Description:
    """What a case says about its files.

    Parameters
    ----------
    identification, recordings, held_out
        Names of files: to identify on, to be explained, to be simulated.
    input, output
        Columns.
    """

    identification: str
    recordings: tuple[str, ...]
    held_out: str
    input: str
    output: str


def read_description(folder: Path) -> Description:
    """Read what a case says about its files.

    Raises
    ------
    ConfigurationError
        It cannot be read, or names a file that is not in the folder.
    """
    path = folder / DESCRIPTION
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        if said["schema"] != SCHEMA:
            raise ConfigurationError(f"{path}: schema is {said['schema']}, must be {SCHEMA}")
        found = Description(
            str(said["identification"]),
            tuple(map(str, said["recordings"])),
            str(said["held_out"]),
            str(said["input"]),
            str(said["output"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: is no {SCHEMA}: {error!r}") from error
    for name in (found.identification, *found.recordings, found.held_out):
        if Path(name).name != name:
            raise ConfigurationError(f"{path}: names {name}, must be files beside it")
    return found


def read_case(folder: Path) -> Case:
    """Read one case: its description and the recordings that it names, nothing else.

    Raises
    ------
    ConfigurationError
        A file of it is missing or cannot be read.
    """
    said = read_description(folder)
    names = (DESCRIPTION, said.identification, *said.recordings, said.held_out)
    try:
        return Case(folder.name, {name: zlib.compress((folder / name).read_bytes(), 1) for name in names})
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: cannot be read: {error.strerror}") from error


def case_folders(study: Path, only: tuple[str, ...] = ()) -> list[Path]:
    """Folders of a study's cases, in order.

    Parameters
    ----------
    study
        Its directory.
    only
        Names of those wanted; none: all.

    Raises
    ------
    ConfigurationError
        There is no finished study.
    UsageError
        A case that is wanted is not in it.
    """
    if not (study / SEAL).is_file():
        raise ConfigurationError(f"{study}: has no {SEAL}, so it is no finished study; piezod blind make draws one")
    found = {path.parent.name: path.parent for path in sorted(study.glob(f"case_*/{DESCRIPTION}"))}
    missing = [name for name in only if name not in found]
    if missing:
        raise UsageError(f"--only names {missing[0]}, {study} has {len(found)} cases, {_ends(list(found))}")
    return [folder for name, folder in found.items() if name in only or not only]


def _ends(names: list[str]) -> str:
    return f"{names[0]} to {names[-1]}" if names else "none"
