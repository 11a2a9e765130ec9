"""Next steps after the history of models, a concealed study, and the catalogue of effects."""

from collections.abc import Sequence
from pathlib import Path

from piezod.report.next_step import BENCH, LATER, NextStep, command, model_line, recorded_and_diagnosed

UNFINISHED = ("unexplained", "partly_explained")  # verdicts that leave something to find
ANOTHER_STUDY = 60  # cases: two hours of one core


def after_history(newest: Path, *, changed: bool, verdict: str | None) -> NextStep:
    """Whether to drive with the newest model.

    Parameters
    ----------
    newest
        File of the newest model.
    changed
        Whether it differs from the model before it.
    verdict
        Verdict of the newest check; None: there is none.
    """
    again = recorded_and_diagnosed(newest, "diagnosis")
    if verdict in UNFINISHED:
        return NextStep(f"the newest check is {verdict.replace('_', ' ')}; record the drive that shows more", again)
    if changed:
        drive = (command("check", BENCH), command("run", BENCH, "--arm"))
        return NextStep("drive with the newest model", drive, (model_line(newest),))
    return NextStep("nothing: keep the newest model; record and diagnose again when the bench changes", again)


def after_fleet(
    archives: Sequence[Path],
    folder: Path,
    *,
    recordings: int,
    unfinished: tuple[str, Path] | None,
    failed: Path | None,
) -> NextStep:
    """The bench or the recording to look at first.

    Parameters
    ----------
    archives, folder
        Archives, and the folder of the pages.
    recordings
        Number of recordings.
    unfinished
        Name and newest model of a bench whose newest recording is not explained; None: there is none.
    failed
        A recording that could not be diagnosed; None: there is none.
    """
    if failed is not None:
        read = command("convert", failed, "-o", "read.csv")
        return NextStep(f"{failed.name} could not be diagnosed; read it alone to see the reason", (read,))
    if unfinished is not None:
        name, model = unfinished
        drive = recorded_and_diagnosed(model, "diagnosis", name="more.csv")
        return NextStep(f"more is left at {name}; record there the drive that shows more", drive)
    words = "nothing: every newest recording is explained; repeat it after the next recordings"
    if not recordings:
        words = "put recordings that their models do not know into the folders of the benches, and repeat it"
    return NextStep(words, (command("history", *archives, "-o", folder),))


def after_blind_make(study: Path) -> NextStep:
    """Diagnose the cases of a new study."""
    verdicts = study.with_name(f"{study.name}-verdicts")
    return NextStep("diagnose its cases", (command("blind", "run", study, "-o", verdicts),))


def after_blind_run(study: Path, verdicts: Path, *, complete: bool) -> NextStep:
    """Score the verdicts.

    Parameters
    ----------
    complete
        Whether every case of the study was diagnosed, and not a choice of them.
    """
    score = command("blind", "score", study, verdicts, *([] if complete else ["--partial"]))
    return NextStep("open the truth and score the verdicts", (score,))


def after_blind_score(study: Path) -> NextStep:
    """Another study, which shows how far the figures depend on the draw."""
    other = study.with_name(f"{study.name}-2")
    words = "another draw shows how far these figures vary"
    return NextStep(words, (command("blind", "make", other, "--cases", ANOTHER_STUDY),))


def after_effects(name: str | None, example: str) -> NextStep:
    """Describe an effect of the list; after its description, whether recordings can show it.

    Parameters
    ----------
    name
        Effect that was described; None: all were listed.
    example
        An effect of the list.
    """
    if name is None:
        return NextStep("describe one of them", (command("effects", example),))
    words = f"see whether your recordings can show {name}"
    return NextStep(words, (command("testable", LATER, "--model", "MODEL.yaml"),))
