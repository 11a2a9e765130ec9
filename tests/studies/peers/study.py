"""The whole comparison: environments, predictions of every peer on every case, then the truth and the table."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezod.blind.case import SEAL, case_folders
from piezod.errors import ConfigurationError, PiezodError, UsageError
from tests.studies.peers.environments import interpreter
from tests.studies.peers.exchange import PREDICTION
from tests.studies.peers.figures import BASE, Row, header, table
from tests.studies.peers.given import given
from tests.studies.peers.run import PEERS, ask, read_answer

FINDINGS = "findings.json"


@dataclass(frozen=True)
class Wanted:
    """What is compared.

    Parameters
    ----------
    study, verdicts
        Folders that `piezod blind make` and `piezod blind run` made.
    only
        Names of cases; none: all.
    cases
        At most so many; None: all.
    peers
        Keys of `PEERS`.
    """

    study: Path
    verdicts: Path
    only: tuple[str, ...]
    cases: int | None
    peers: tuple[str, ...]


@dataclass(frozen=True)
class Compared:
    """What came of a comparison.

    Parameters
    ----------
    rows
        Of the table, `piezod` first.
    left_out
        Cases that no peer could be asked about.
    """

    rows: tuple[Row, ...]
    left_out: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """Whether every peer predicted every case."""
        return not self.left_out and not any(case.failed for row in self.rows[1:] for case in row.cases)


def compare(wanted: Wanted, folder: Path, cache: Path) -> Compared:
    """Ask the peers about every case, one process at a time; then open the truth and print the table.

    Parameters
    ----------
    wanted
        What is compared.
    folder
        That is there. Answers go to `folder/PEER/CASE`; what is there already is not asked again.
    cache
        Of the environments.

    Raises
    ------
    UsageError
        A peer or a case is not there, or the folder holds answers on another study.
    ConfigurationError
        A case has no verdict.
    TemporaryError
        An environment cannot be made.
    """
    if unknown := sorted(set(wanted.peers) - set(PEERS)):
        raise UsageError(f"--peers names {', '.join(unknown)}; there are {', '.join(PEERS)}")
    cases = case_folders(wanted.study, wanted.only)[: wanted.cases]
    for case in cases:
        if not (wanted.verdicts / case.name / FINDINGS).is_file():
            raise ConfigurationError(f"{wanted.verdicts / case.name}: has no verdict; run piezod blind run first")
    _mark(folder, wanted.study)
    pythons = {key: interpreter(key, PEERS[key].packages, cache) for key in wanted.peers}
    left_out = [case.name for case in cases if not _ask(case, wanted.verdicts / case.name, pythons, folder)]
    asked = [case.name for case in cases if case.name not in left_out]
    rows = table(wanted.study, wanted.verdicts, folder, asked, wanted.peers)
    print("\n".join([header(), *(row.text() for row in rows)]))
    print(
        f"{len(asked)} cases, {len(left_out)} left out; worse: than the identified model alone; s: median, on one core"
    )
    return Compared(tuple(rows), tuple(left_out))


def _mark(folder: Path, study: Path) -> None:
    """Mark a folder as one of this study's answers; refuse one of another's."""
    mark, seal = folder / SEAL, (study / SEAL).read_bytes()
    if mark.is_file() and mark.read_bytes() != seal:
        raise UsageError(f"--folder is {folder}, which holds answers on another study than {study}; take another one")
    mark.write_bytes(seal)


def _ask(case: Path, verdict: Path, pythons: Mapping[str, Path], folder: Path) -> bool:
    """Ask every peer that has not answered; whether the case could be given to them."""
    kept = folder / BASE / case.name / PREDICTION
    waiting = [key for key in pythons if read_answer(PEERS[key], folder / key / case.name) is None]
    if not waiting and kept.is_file():
        return True
    try:
        found = given(case, verdict)
    except PiezodError as error:
        print(f"{case.name} left out: {error}", flush=True)
        return False
    kept.parent.mkdir(parents=True, exist_ok=True)
    np.savez(kept, force_N=found.held_out["base_N"])
    for key in waiting:
        answer = ask(PEERS[key], pythons[key], found, folder / key / case.name)
        print(f"{case.name} {PEERS[key].name}: {answer.words}", flush=True)
    return True
