"""`python -m piezod.history.worker TASK OUTCOME`: the process that diagnoses one recording of an archive."""

import json
import sys
import time
from pathlib import Path

from piezod import __version__
from piezod.diagnose.command import diagnose_files
from piezod.tasks.task import RUN
from piezod.tasks.worker import serve

MODEL, TASK = "model.yaml", "task.json"
SCHEMA = "piezod.archive/1"


def main() -> None:
    """Diagnose the recording that `task.json` names with the given model."""
    task = json.loads(Path(sys.argv[1], TASK).read_text(encoding="utf-8"))

    def diagnose(outcome: Path) -> None:
        diagnose_files([Path(task["recording"])], Path(MODEL), outcome, None, None, lambda *_: None)
        finish(outcome, None)

    def finish(outcome: Path, failed: str | None) -> None:
        run = {
            "schema": SCHEMA,
            "by": f"piezod {__version__}",
            "recording": task["recording_sha256"],
            "given": task["given_sha256"],
            "cpu_s": round(time.process_time(), 3),
            "failed": failed,
        }
        (outcome / RUN).write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")

    serve(diagnose, finish)


if __name__ == "__main__":
    main()
