"""`python -m tests.unit.tasks.echo TASK OUTCOME`: writes back what its task holds; "die" ends the process."""

import json
import os
from pathlib import Path

from piezod.tasks.worker import serve


def work(outcome: Path) -> None:
    text = Path("text").read_text(encoding="utf-8")
    if text == "die":
        os._exit(3)
    if text == "raise":
        raise ValueError(text)
    outcome.mkdir()
    (outcome / "text").write_text(text, encoding="utf-8")
    fail(outcome, None)


def fail(outcome: Path, reason: str | None) -> None:
    (outcome / "run.json").write_text(json.dumps({"failed": reason}), encoding="utf-8")


if __name__ == "__main__":
    serve(work, fail)
