"""One case of a study: the recordings that an engineer would have, without the sealed truth."""

import json
import zlib
from dataclasses import dataclass
from pathlib import Path

from piezod.errors import ConfigurationError, UsageError
from piezod.tasks.task import Task

SEAL = "seal.json"
DESCRIPTION = "case.json"
SCHEMA = "firmware_sim.concealed.case/1"
LIFE_SCHEMA = "firmware_sim.concealed.life/1"
WORKER = "piezod.blind.worker"


@dataclass(frozen=True)
class Description:
    """Content of a case's description file.

    Parameters
    ----------
    identification, recordings, held_out
        File names of the recordings for the identification, for the diagnosis, and for the held-out simulation.
    input, output
        Names of the input and output columns.
    is_life
        Whether the recordings follow each other in time, and each is diagnosed with the model of the step before.
    """

    identification: str
    recordings: tuple[str, ...]
    held_out: str
    input: str
    output: str
    is_life: bool = False


def read_description(folder: Path) -> Description:
    """Read the description file of a case.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or names a file outside of the folder.
    """
    path = folder / DESCRIPTION
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] not in (SCHEMA, LIFE_SCHEMA):
            raise ConfigurationError(f"{path}: schema is {content['schema']}, must be {SCHEMA} or {LIFE_SCHEMA}")
        description = Description(
            str(content["identification"]),
            tuple(map(str, content["recordings"])),
            str(content["held_out"]),
            str(content["input"]),
            str(content["output"]),
            is_life=content["schema"] == LIFE_SCHEMA,
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: is no {SCHEMA}: {error!r}") from error
    for name in (description.identification, *description.recordings, description.held_out):
        if Path(name).name != name:
            raise ConfigurationError(f"{path}: names {name}, must be files beside it")
    return description


def read_case(folder: Path) -> Task:
    """Read the description of a case and the recordings that it names; other files in the folder are not read.

    Raises
    ------
    ConfigurationError
        One of the files is missing or cannot be read.
    """
    description = read_description(folder)
    names = (DESCRIPTION, description.identification, *description.recordings, description.held_out)
    try:
        files = {name: zlib.compress((folder / name).read_bytes(), 1) for name in names}
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: cannot be read: {error.strerror}") from error
    return Task(folder.name, files, WORKER)


def case_folders(study: Path, only: tuple[str, ...] = ()) -> list[Path]:
    """Folders of a study's cases, in the order of their names.

    Parameters
    ----------
    only
        Names of the cases to return; empty: all.

    Raises
    ------
    ConfigurationError
        The folder holds no finished study.
    UsageError
        A name in `only` is not the name of a case.
    """
    if not (study / SEAL).is_file():
        raise ConfigurationError(f"{study}: has no {SEAL}, so it is no finished study; piezod blind make draws one")
    cases = {path.parent.name: path.parent for path in sorted(study.glob(f"case_*/{DESCRIPTION}"))}
    missing = [name for name in only if name not in cases]
    if missing:
        listed = f"{next(iter(cases))} to {next(reversed(cases))}" if cases else "none"
        raise UsageError(f"--only names {missing[0]}, {study} has {len(cases)} cases, {listed}")
    return [folder for name, folder in cases.items() if name in only or not only]
