"""Verdicts on cases and their folder: the verdict on a case is the folder `VERDICTS/case_0001/`, complete or absent.

A failed case has a verdict too. Its findings state that effects are present but name none, which is wrong for every
truth. So a score counts the failure as wrong and never leaves it out.
"""

import hashlib
import json
from pathlib import Path

from piezod import __version__
from piezod.blind.case import SEAL
from piezod.errors import ConfigurationError, UsageError
from piezod.runtime.files import written, written_folder
from piezod.tasks.task import RUN, Outcome, failed_outcome, read_outcome

FINDINGS, STUDY = "findings.json", "study.json"
SCHEMA, FINDINGS_SCHEMA = "piezod.blind/1", "piezod.findings/2"


Verdict = Outcome  # files that the diagnosis of a case wrote


def run_json(elapsed_s: float, identification_s: float = 0.0, failed: str | None = None) -> bytes:
    """Content of `run.json`.

    Parameters
    ----------
    elapsed_s, identification_s
        Duration of the diagnosis and of the identification before it [s].
    failed
        Reason of the failure, one line; None: no failure.
    """
    content = {
        "schema": SCHEMA,
        "by": f"piezod {__version__}",
        "elapsed_s": round(elapsed_s, 3),
        "identification_s": round(identification_s, 3),
        "failed": failed,
    }
    return (json.dumps(content, indent=1) + "\n").encode()


def failed_verdict(name: str, reason: str, elapsed_s: float = 0.0) -> Verdict:
    """Verdict on a case whose diagnosis failed.

    Parameters
    ----------
    elapsed_s
        Time until the failure [s].
    """
    reason = str(failed_outcome(name, reason).failed)
    findings = {
        "schema": FINDINGS_SCHEMA,
        "verdict": "explained",
        "words": f"no verdict: {reason}; these findings are wrong for every truth, so that the failure counts",
        "where": [],
        "effects": [],
        "failed": reason,
    }
    text = (json.dumps(findings, indent=2) + "\n").encode()
    return Verdict(name, {FINDINGS: text, RUN: run_json(elapsed_s, failed=reason)}, reason)


def read_verdict(name: str, folder: Path) -> Verdict | None:
    """Verdict in a folder; None: the folder holds no complete verdict.

    Parameters
    ----------
    folder
        Folder of the verdict on this case.
    """
    verdict = read_outcome(name, folder)
    return verdict if verdict is not None and FINDINGS in verdict.files else None


def as_verdict(outcome: Outcome) -> Verdict:
    """Outcome as a verdict; without findings, the failure becomes findings."""
    if FINDINGS in outcome.files:
        return outcome
    return failed_verdict(outcome.name, outcome.failed or "it wrote no findings")


class VerdictFolder:
    """Folder of the verdicts on one study.

    Parameters
    ----------
    folder
        Path; the folder is created if it does not exist.

    Raises
    ------
    ConfigurationError
        The folder cannot be written.
    UsageError
        The folder holds verdicts on another study.
    """

    def __init__(self, folder: Path, study: Path) -> None:
        self._folder = folder
        sealed = hashlib.sha256((study / SEAL).read_bytes()).hexdigest()
        mark = folder / STUDY
        try:
            if not mark.is_file():
                written(mark, json.dumps({"schema": SCHEMA, "seal_sha256": sealed}) + "\n", parents=True)
            known = json.loads(mark.read_text(encoding="utf-8"))["seal_sha256"]
        except OSError as error:
            raise ConfigurationError(f"{folder}: cannot be written: {error.strerror}") from error
        except (ValueError, KeyError) as error:
            raise ConfigurationError(f"{mark}: is no {SCHEMA}: {error!r}; take another folder") from error
        if known != sealed:
            raise UsageError(f"-o is {folder}, which holds verdicts on another study than {study}; take another folder")

    def has(self, name: str) -> bool:
        """Whether the folder holds a verdict on this case that is no failure."""
        verdict = read_verdict(name, self._folder / name)
        return verdict is not None and verdict.failed is None

    def save(self, verdict: Verdict) -> None:
        """Write a verdict; an earlier verdict on the case is replaced.

        Raises
        ------
        ConfigurationError
            The verdict cannot be written.
        """
        written_folder(self._folder / verdict.name, verdict.files)
