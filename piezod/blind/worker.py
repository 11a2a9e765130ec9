"""`python -m piezod.blind.worker CASE VERDICT`: the process that diagnoses one case."""

import time
from pathlib import Path

from piezod.blind.case import read_description
from piezod.blind.diagnose_case import diagnose_case
from piezod.blind.diagnose_life import diagnose_life
from piezod.blind.verdict import failed_verdict, run_json
from piezod.tasks.task import RUN
from piezod.tasks.worker import serve


def main() -> None:
    """Diagnose the case in the folder of the command line; a failure is written as a verdict too."""
    begun_s = time.monotonic()

    def diagnose(verdict: Path) -> None:
        durations = diagnose_life(verdict) if read_description(Path()).is_life else diagnose_case(verdict)
        (verdict / RUN).write_bytes(run_json(durations.diagnosis_s, durations.identification_s))

    def fail(verdict: Path, reason: str) -> None:
        for name, content in failed_verdict(verdict.name, reason, time.monotonic() - begun_s).files.items():
            (verdict / name).write_bytes(content)

    serve(diagnose, fail)


if __name__ == "__main__":
    main()
