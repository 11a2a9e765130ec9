"""What was said of a case, and where it is kept: `VERDICTS/case_0001/`, whole or not at all.

A case that failed is written down too: as findings that are wrong whatever the truth is (something is there, and no
name for it is given), so that a score counts the failure and never leaves it out.
"""

import hashlib
import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from piezod import __version__
from piezod.blind.case import SEAL
from piezod.errors import ConfigurationError, UsageError

FINDINGS, RUN, STUDY = "findings.json", "run.json", "study.json"
SCHEMA, FINDINGS_SCHEMA = "piezod.blind/1", "piezod.findings/1"


@dataclass(frozen=True)
class Verdict:
    """What was said of a case.

    Parameters
    ----------
    name
        Of the case.
    files
        Contents by the name of the file.
    failed
        One line; None: it did not.
    """

    name: str
    files: dict[str, bytes]
    failed: str | None = None


def run_json(elapsed_s: float, identification_s: float = 0.0, failed: str | None = None) -> bytes:
    """Content of `run.json`.

    Parameters
    ----------
    elapsed_s, identification_s
        Of the diagnosis, and of the identification before it [s].
    failed
        One line.
    """
    said = {
        "schema": SCHEMA,
        "by": f"piezod {__version__}",
        "elapsed_s": round(elapsed_s, 3),
        "identification_s": round(identification_s, 3),
        "failed": failed,
    }
    return (json.dumps(said, indent=1) + "\n").encode()


def failed_verdict(name: str, why: str, elapsed_s: float = 0.0) -> Verdict:
    """The verdict on a case that failed.

    Parameters
    ----------
    name
        Of the case.
    why
        One line.
    elapsed_s
        Until it failed [s].
    """
    why = " ".join(why.split())[:500]
    findings = {
        "schema": FINDINGS_SCHEMA,
        "verdict": "explained",
        "words": f"no verdict: {why}; these findings are wrong whatever the truth is, and are to be counted so",
        "where": [],
        "effects": [],
        "failed": why,
    }
    text = (json.dumps(findings, indent=2) + "\n").encode()
    return Verdict(name, {FINDINGS: text, RUN: run_json(elapsed_s, failed=why)}, why)


def read_verdict(name: str, folder: Path) -> Verdict | None:
    """The verdict in a folder; None: there is none, or not a whole one."""
    try:
        files = {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}
        failed = json.loads(files[RUN])["failed"]
    except (OSError, ValueError, KeyError):
        return None
    return Verdict(name, files, failed) if FINDINGS in files else None


class Verdicts:
    """A folder of verdicts on one study.

    Parameters
    ----------
    folder
        Made where it is not there.
    study
        Directory of the study.

    Raises
    ------
    ConfigurationError
        The folder cannot be written.
    UsageError
        It holds verdicts on another study.
    """

    def __init__(self, folder: Path, study: Path) -> None:
        self._folder = folder
        sealed = hashlib.sha256((study / SEAL).read_bytes()).hexdigest()
        mark = folder / STUDY
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not mark.is_file():
                mark.write_text(json.dumps({"schema": SCHEMA, "seal_sha256": sealed}) + "\n", encoding="utf-8")
            known = json.loads(mark.read_text(encoding="utf-8"))["seal_sha256"]
        except OSError as error:
            raise ConfigurationError(f"{folder}: cannot be written: {error.strerror}") from error
        except (ValueError, KeyError) as error:
            raise ConfigurationError(f"{mark}: is no {SCHEMA}: {error!r}; take another folder") from error
        if known != sealed:
            raise UsageError(f"-o is {folder}, which holds verdicts on another study than {study}; take another folder")

    def has(self, name: str) -> bool:
        """Whether a case was judged; one that failed was not."""
        verdict = read_verdict(name, self._folder / name)
        return verdict is not None and verdict.failed is None

    def keep(self, verdict: Verdict) -> None:
        """Write a verdict; a failure that stood there before is replaced.

        Raises
        ------
        ConfigurationError
            It cannot be written.
        """
        target = self._folder / verdict.name
        try:
            with tempfile.TemporaryDirectory(prefix=f".{verdict.name}.", dir=self._folder) as temporary:
                part = Path(temporary) / verdict.name
                part.mkdir()
                for name, content in verdict.files.items():
                    (part / name).write_bytes(content)
                shutil.rmtree(target, ignore_errors=True)
                part.rename(target)
        except OSError as error:
            raise ConfigurationError(f"{target}: cannot be written: {error.strerror}") from error
