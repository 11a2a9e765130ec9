"""Making and scoring a study, by the command `python -m firmware_sim.concealed` in a separate process.

The simulated plant shares no code with this package; only its command line is used here.
"""

import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path

from piezod.blind.case import DESCRIPTION
from piezod.blind.verdict import read_verdict
from piezod.errors import CheckFailedError, ConfigurationError, PiezodError, UsageError
from piezod.runtime.interpreter import python

MODULE = "firmware_sim.concealed"  # module whose command makes and scores a study
PROGRESS_EVERY_S = 0.2  # time between two reports of progress [s]


def make_study(directory: Path, options: Mapping[str, object], on_cases: Callable[[int], None]) -> None:
    """Draw the cases or the lives of a study and seal the truth.

    Parameters
    ----------
    directory
        Folder of the study, which must not exist yet.
    options
        Number of `cases` or of `lives`, and values of `seed`, `kind`, `effect`, `strength`, `family`, `amid`, `varied`
        and `jobs`; None or False: the default of the command.
    on_cases
        Called repeatedly with the number of cases drawn so far.

    Raises
    ------
    UsageError, ConfigurationError
        The command refuses its arguments or cannot write the study.
    """
    given = [
        f"--{name}" if value is True else f"--{name}={value}"
        for name, value in options.items()
        if value is not None and value is not False
    ]
    command = python("-m", MODULE, "make", str(directory), *given)
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as plant:  # noqa: S603  # our own interpreter
        try:
            while True:
                try:
                    _, errors = plant.communicate(timeout=PROGRESS_EVERY_S)
                    break
                except subprocess.TimeoutExpired:
                    on_cases(sum(1 for _ in directory.glob(f"case_*/{DESCRIPTION}")))
        except BaseException:
            plant.kill()
            raise
    _check(plant.returncode, errors)


def score_study(directory: Path, verdicts: Path, *, as_json: bool, partial: bool) -> str:
    """Open the truth and score the verdicts.

    Parameters
    ----------
    directory, verdicts
        Folders of the study and of the verdicts on its cases.
    as_json
        Return every figure and every case as JSON.
    partial
        Leave out cases without a verdict; a failed case still counts as wrong.

    Returns
    -------
    str
        Table of figures and the failed cases, or JSON.

    Raises
    ------
    ConfigurationError
        The truth differs from the sealed one, or a verdict is missing.
    """
    flags = [*(["--json"] if as_json else []), *(["--partial"] if partial else [])]
    command = python("-m", MODULE, "score", str(directory), str(verdicts), *flags)
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  # as above
    _check(done.returncode, done.stderr)
    return done.stdout if as_json else done.stdout + _failures(verdicts)


def _failures(verdicts: Path) -> str:
    done = [read_verdict(folder.name, folder) for folder in sorted(verdicts.glob("case_*"))]
    lines = [f"{each.name} failed: {each.failed}" for each in done if each is not None and each.failed is not None]
    return "\n".join(["", f"{len(lines)} cases without findings, counted as wrong", *lines, ""]) if lines else ""


def _check(code: int, errors: str) -> None:
    """Raise the error of the command: its last line on stderr."""
    if code == 0:
        return
    kinds: dict[int, type[PiezodError]] = {2: UsageError, 78: ConfigurationError}
    line = errors.strip().splitlines()[-1] if errors.strip() else f"python -m {MODULE} ended with {code}"
    raise kinds.get(code, CheckFailedError)(line.removeprefix(f"python -m {MODULE} ").removeprefix("make: error: "))
