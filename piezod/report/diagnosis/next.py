"""The next step after a diagnosis."""

from collections.abc import Sequence
from pathlib import Path

from piezod.diagnose.judgement import Diagnosis
from piezod.model import without_inverse
from piezod.report.next_step import NextStep, after_diagnose


def next_after(
    diagnosis: Diagnosis, recordings: Sequence[Path], model: Path, folder: Path, bench: Path | None = None
) -> NextStep:
    """Next step after a diagnosis.

    Parameters
    ----------
    recordings, model, folder
        Files of the diagnosis, and the folder of its result.
    bench
        Bench file; None: not named.
    """
    written = diagnosis.model
    return after_diagnose(
        diagnosis.findings,
        recordings,
        model,
        folder,
        refused=without_inverse(written),
        bench=bench,
        drives_a_bench=(written.input.unit, written.output.unit) == ("V", "N"),
    )
