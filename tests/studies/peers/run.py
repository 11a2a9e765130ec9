"""A peer on a case: a process in a folder of its own that holds what it is given, and nothing else of the study.

The peer's program is copied there. Its environment variables are a path and one thread; it is told no other folder.
"""

import hashlib
import json
import math
import os
import shutil
import subprocess
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from piezod.tasks.isolated import SINGLE_THREAD
from tests.studies.peers.exchange import PREDICTION, SAID
from tests.studies.peers.given import Given

WITHIN_s = 1200.0
HERE = Path(__file__).parent
EXCHANGE = HERE / "exchange.py"
ANSWER = "answer.json"


@dataclass(frozen=True)
class Peer:
    """A method to compare with.

    Parameters
    ----------
    name
        In the table.
    program
        Its file, run by the Python of its environment.
    packages
        That it needs.
    speaks
        Whether it keeps terms that a person can read.
    """

    name: str
    program: Path
    packages: tuple[str, ...]
    speaks: bool = True

    @property
    def version(self) -> str:
        """Of its program: answers of another one do not count."""
        return hashlib.sha256(EXCHANGE.read_bytes() + self.program.read_bytes()).hexdigest()[:16]


PEERS = {
    "pysindy": Peer("PySINDy, discrepancy", HERE / "discrepancy.py", ("pysindy",)),
    "sysidentpy": Peer("SysIdentPy, FROLS", HERE / "narx.py", ("sysidentpy",)),
    "ridge": Peer("ridge, lagged columns", HERE / "lagged.py", ("scikit-learn",), speaks=False),
}


@dataclass(frozen=True)
class Answer:
    """The answer of a peer to a case.

    Parameters
    ----------
    terms
        It kept beside the identified model; none: nothing is missing.
    setting
        That was best on the last part of the recordings.
    settings
        How many it compared.
    busy_s
        Processor time without its imports, so that a busy machine does not count [s].
    diverged
        Its prediction left the identified model's by more than the measured range, and was cut there.
    failed
        Why there is no prediction; empty: there is one.
    version
        Of the peer's program.
    """

    terms: tuple[str, ...] = ()
    setting: str = ""
    settings: int = 0
    busy_s: float = math.nan
    diverged: bool = False
    failed: str = ""
    version: str = ""

    @property
    def words(self) -> str:
        """In one line."""
        if self.failed:
            return f"failed: {self.failed}"
        diverged = "; diverged, cut at the measured range" if self.diverged else ""
        return f"{len(self.terms)} terms; {self.setting}; {self.busy_s:.1f} s{diverged}"


def ask(peer: Peer, python: Path, case: Given, folder: Path) -> Answer:
    """Let a peer predict a case and keep what it says.

    Parameters
    ----------
    peer, python
        Which, and the Python that runs it.
    case
        What it is given.
    folder
        Made where it is not there; prediction and answer go there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="peer-") as name:
        scratch = Path(name)
        case.write(scratch)
        shutil.copy(EXCHANGE, scratch / EXCHANGE.name)
        shutil.copy(peer.program, scratch / peer.program.name)
        why = _run(python, peer.program.name, scratch)
        answer, force_N = _answer(scratch, case) if not why else (Answer(failed=why), None)
    (folder / PREDICTION).unlink(missing_ok=True)
    if force_N is not None:
        np.savez(folder / PREDICTION, force_N=force_N)
    answer = replace(answer, version=peer.version)
    (folder / ANSWER).write_text(json.dumps(asdict(answer), indent=1) + "\n", encoding="utf-8")
    return answer


def read_answer(peer: Peer, folder: Path) -> Answer | None:
    """The stored answer of this version of a peer; None when it is missing or incomplete."""
    try:
        stored = json.loads((folder / ANSWER).read_text(encoding="utf-8"))
        return Answer(**stored | {"terms": tuple(stored["terms"])}) if stored["version"] == peer.version else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def read_prediction(folder: Path) -> np.ndarray | None:
    """Predicted force of the held-out record, shape (n,) [N]; None: there is none."""
    path = folder / PREDICTION
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as file:
        return np.asarray(file["force_N"], dtype=np.float64)


def _run(python: Path, program: str, scratch: Path) -> str:
    """Run a peer's program; what was wrong with that, in words, or nothing."""
    variables = {"PATH": os.defpath, "HOME": str(scratch), "MPLCONFIGDIR": str(scratch), **SINGLE_THREAD}
    try:
        done = subprocess.run(
            [str(python), program],
            cwd=scratch,
            env=variables,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=WITHIN_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"took more than {WITHIN_s:g} s"
    messages = done.stderr.strip().splitlines() or ["no message"]
    return f"ended with {done.returncode}: {messages[-1]}" if done.returncode else ""


def _answer(scratch: Path, case: Given) -> tuple[Answer, np.ndarray | None]:
    """The answer, and the prediction, limited to the measured range around the identified model."""
    try:
        content = json.loads((scratch / SAID).read_text(encoding="utf-8"))
        force_N = read_prediction(scratch)
    except (OSError, ValueError, KeyError) as error:
        return Answer(failed=f"its answer cannot be read: {error!r}"), None
    base_N = case.held_out["base_N"]
    if force_N is None or force_N.shape != base_N.shape:
        return Answer(failed="its prediction is missing or has another length than the held-out record"), None
    change_N = np.nan_to_num(force_N - base_N, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    diverged = bool(np.max(np.abs(change_N)) > case.span_N)
    answer = Answer(tuple(content["terms"]), content["setting"], content["settings"], content["busy_s"], diverged)
    return answer, base_N + np.clip(change_N, -case.span_N, case.span_N)
