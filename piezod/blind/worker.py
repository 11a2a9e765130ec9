"""`python -m piezod.blind.worker CASE VERDICT`: the process that judges one case, and ends when its starter does."""

import os
import shutil
import sys
import threading
import time
import traceback
from pathlib import Path

from piezod.blind.diagnose_case import judge
from piezod.blind.verdict import RUN, failed_verdict, run_json
from piezod.errors import PiezodError


def main(case: Path, verdict: Path) -> None:
    """Judge a case.

    Parameters
    ----------
    case
        Folder with its files, in one that is there for this alone; becomes the current directory.
    verdict
        Folder, written to; a failure goes there too.
    """
    threading.Thread(target=_end_with_starter, args=(case.parent,), daemon=True).start()
    os.chdir(case)
    begun_s = time.monotonic()
    try:
        took = judge(verdict)
    except Exception as error:  # noqa: BLE001  # whatever it is, it is a failure that must be counted
        verdict.mkdir(exist_ok=True)
        failed = failed_verdict(verdict.name, _line(error), time.monotonic() - begun_s)
        for name, content in failed.files.items():
            (verdict / name).write_bytes(content)
        return
    (verdict / RUN).write_bytes(run_json(took.diagnosis_s, took.identification_s))


def _end_with_starter(scratch: Path) -> None:
    """Wait until the other end of standard input is gone; nobody else will clean up then."""
    os.read(sys.stdin.fileno(), 1)  # unbuffered: the buffer's lock would be held when the process ends
    shutil.rmtree(scratch, ignore_errors=True)
    os._exit(1)


def _line(error: Exception) -> str:
    """What was said, and of a mistake of ours where it happened."""
    if isinstance(error, PiezodError):
        return str(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {error}"


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
