"""`python -m piezod.blind.worker CASE VERDICT`: the process that diagnoses one case; ends with its parent process."""

import os
import shutil
import sys
import threading
import time
import traceback
from pathlib import Path

from piezod.blind.case import read_description
from piezod.blind.diagnose_case import diagnose_case
from piezod.blind.diagnose_life import diagnose_life
from piezod.blind.verdict import RUN, failed_verdict, run_json
from piezod.errors import PiezodError


def main(case: Path, verdict: Path) -> None:
    """Diagnose a case.

    Parameters
    ----------
    case
        Folder with the files of the case, within a temporary folder for it alone; becomes the current directory.
    verdict
        Folder for the verdict; a failure is written there too.
    """
    threading.Thread(target=_end_with_parent, args=(case.parent,), daemon=True).start()
    os.chdir(case)
    begun_s = time.monotonic()
    try:
        durations = diagnose_life(verdict) if read_description(Path()).is_life else diagnose_case(verdict)
    except Exception as error:  # noqa: BLE001  # any error is a failure that must count
        verdict.mkdir(exist_ok=True)
        failed = failed_verdict(verdict.name, _line(error), time.monotonic() - begun_s)
        for name, content in failed.files.items():
            (verdict / name).write_bytes(content)
        return
    (verdict / RUN).write_bytes(run_json(durations.diagnosis_s, durations.identification_s))


def _end_with_parent(scratch: Path) -> None:
    """Wait until the parent's end of standard input is closed, delete the temporary folder and end this process."""
    os.read(sys.stdin.fileno(), 1)  # unbuffered: a held lock of the buffer would block the exit
    shutil.rmtree(scratch, ignore_errors=True)
    os._exit(1)


def _line(error: Exception) -> str:
    """Message of an error; for an unexpected error also its type and place."""
    if isinstance(error, PiezodError):
        return str(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {error}"


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
