"""The two ends of a study, in a process of their own: the plant that draws cases, and what opens its truth.

The plant shares no code with this package; only its command line is known here.
"""

import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from piezod.blind.case import DESCRIPTION
from piezod.blind.verdict import read_verdict
from piezod.errors import CheckFailedError, ConfigurationError, PiezodError, UsageError

MODULE = "firmware_sim.concealed"
LOOK_EVERY_S = 0.2


def make_study(directory: Path, cases: int, options: Mapping[str, object], on_cases: Callable[[int], None]) -> None:
    """Draw the cases of a study and seal the truth.

    Parameters
    ----------
    directory
        Where there is none yet.
    cases
        How many, at least 1.
    options
        `seed`, `kind`, `effect`, `strength`, `jobs`; None: as the plant has it.
    on_cases
        Called now and then with how many are drawn.

    Raises
    ------
    UsageError, ConfigurationError
        What the plant refuses.
    """
    given = [f"--{name}={value}" for name, value in options.items() if value is not None]
    command = [sys.executable, "-m", MODULE, "make", str(directory), f"--cases={cases}", *given]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as plant:  # noqa: S603  # our own interpreter
        try:
            while True:
                try:
                    _, said = plant.communicate(timeout=LOOK_EVERY_S)
                    break
                except subprocess.TimeoutExpired:
                    on_cases(sum(1 for _ in directory.glob(f"case_*/{DESCRIPTION}")))
        except BaseException:
            plant.kill()
            raise
    _check(plant.returncode, said)


def score_study(directory: Path, verdicts: Path, *, as_json: bool, partial: bool) -> str:
    """Open the truth and judge the verdicts.

    Parameters
    ----------
    directory, verdicts
        Of the study, and what was said of its cases.
    as_json
        Every figure and every case, as JSON.
    partial
        Leave out cases that were not run; those that failed count.

    Returns
    -------
    str
        The table, and which cases failed.

    Raises
    ------
    ConfigurationError
        The truth is not the one that was sealed, or a verdict is missing.
    """
    flags = [*(["--json"] if as_json else []), *(["--partial"] if partial else [])]
    command = [sys.executable, "-m", MODULE, "score", str(directory), str(verdicts), *flags]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  # as above
    _check(done.returncode, done.stderr)
    return done.stdout if as_json else done.stdout + _failures(verdicts)


def _failures(verdicts: Path) -> str:
    found = [read_verdict(folder.name, folder) for folder in sorted(verdicts.glob("case_*"))]
    lines = [f"{one.name} failed: {one.failed}" for one in found if one is not None and one.failed is not None]
    return "\n".join(["", f"{len(lines)} cases without findings, counted as wrong", *lines, ""]) if lines else ""


def _check(code: int, said: str) -> None:
    """Raise what the plant's process refused, in its last line."""
    if code == 0:
        return
    kinds: dict[int, type[PiezodError]] = {2: UsageError, 78: ConfigurationError}
    line = said.strip().splitlines()[-1] if said.strip() else f"python -m {MODULE} ended with {code}"
    raise kinds.get(code, CheckFailedError)(line.removeprefix(f"python -m {MODULE} ").removeprefix("make: error: "))
