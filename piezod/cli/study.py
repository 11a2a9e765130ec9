"""`piezod blind`: the concealed study."""

from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.output import print_next
from piezod.cli.root import JsonOption, app
from piezod.errors import UsageError

blind = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="The concealed study: make, run, score.")
app.add_typer(blind, name="blind")

JobsOption = Annotated[int | None, typer.Option(min=1, help="Number of processes; default: one per core.")]
StudyArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the study.")]


@blind.command("make", epilog="Example: piezod blind make study --cases 300")
def blind_make(
    directory: StudyArgument,
    cases: Annotated[int | None, typer.Option(metavar="N", min=1, help="Number of cases.")] = None,
    lives: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of lives: each a bench with five recordings and one change."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="The same seed makes the same study; default: random.")
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="null, single, pair, triple, foreign or unrecorded; default: all."),
    ] = None,
    effect: Annotated[
        str | None, typer.Option(metavar="NAME", help="Effect in every case except null; default: all in turn.")
    ] = None,
    strength: Annotated[
        float | None, typer.Option(metavar="X", help="Strength relative to the noise; default: 0.8, 4 and 20 in turn.")
    ] = None,
    family: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Laws of the plants: preisach, bouc_wen, plays, interpolated, or each in turn."
        ),
    ] = None,
    amid: Annotated[
        float | None,
        typer.Option(min=0.0, metavar="S", help="Seconds missing at the begin of the work of every third case."),
    ] = None,
    varied: Annotated[
        bool,
        typer.Option("--varied", help="Draw rate, start, tare, voltmeter and kinds of command of each bench."),
    ] = False,
    jobs: JobsOption = None,
) -> None:
    """Draw cases from a simulated plant that shares no code with this program, and seal the truth."""
    if (cases is None) == (lives is None):
        raise UsageError("--cases and --lives: give one of them")
    if lives is not None and (varied or any(option is not None for option in (kind, effect, strength, amid))):
        raise UsageError(
            "--lives draws its own changes: --kind, --effect, --strength, --amid and --varied are for --cases"
        )
    from piezod.blind.study import make_study
    from piezod.diagnose.hypothesis.parallel import core_count
    from piezod.report.next_step.of_studies import after_blind_make
    from piezod.report.progress import steps

    options = {"cases": cases, "lives": lives, "seed": seed, "kind": kind, "effect": effect, "strength": strength}
    options |= {"family": family, "amid": amid, "varied": varied, "jobs": jobs or core_count()}
    count = cases or lives or 1
    with steps() as show:
        make_study(directory, options, lambda drawn: show("drawing", drawn / count))
    print(f"{directory}: {count} {'cases' if lives is None else 'lives'}, truth sealed")
    print_next(after_blind_make(directory))


@blind.command("run", epilog="Example: piezod blind run study -o verdicts --scheduler tcp://10.0.0.1:8786")
def blind_run(
    directory: StudyArgument,
    output: Annotated[
        Path,
        typer.Option("-o", metavar="VERDICTS", help="Folder for verdicts; cases with a verdict in it are left out."),
    ],
    jobs: JobsOption = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster that diagnoses the cases.")
    ] = None,
    only: Annotated[
        str | None, typer.Option(metavar="CASE,...", help="Cases to diagnose, such as case_0001,case_0007.")
    ] = None,
) -> None:
    """Identify, diagnose and simulate every case of a study; an interrupted run continues."""
    from piezod.blind.run import run_study
    from piezod.blind.verdict import Verdict
    from piezod.report.next_step.of_studies import after_blind_run
    from piezod.report.progress import steps

    if jobs is not None and scheduler is not None:
        raise UsageError("--jobs is for this machine, --scheduler for a cluster: give one of them")
    with steps(show_after_s=0.0) as show:

        def report(verdict: Verdict | None, done: int, of: int) -> None:
            if verdict is not None and verdict.failed is not None:
                print(f"{verdict.name} failed: {verdict.failed}", flush=True)
            show(f"{done} of {of} cases", done / of)

        wanted = tuple(only.split(",")) if only else ()
        ran = run_study(directory, output, jobs=jobs, scheduler=scheduler, only=wanted, on_verdict=report)
    print(f"{output}: {ran.diagnosed} cases diagnosed, {ran.failed} failed, {ran.already} were already done")
    print_next(after_blind_run(directory, output, complete=not wanted))
    raise typer.Exit(1 if ran.failed else 0)


@blind.command("score", epilog="Example: piezod blind score study verdicts")
def blind_score(
    directory: StudyArgument,
    verdicts: Annotated[Path, typer.Argument(metavar="VERDICTS", help="Folder that piezod blind run wrote.")],
    partial: Annotated[bool, typer.Option("--partial", help="Leave out cases without a verdict.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Open the sealed truth and score the verdicts."""
    from piezod.blind.study import score_study
    from piezod.report.next_step.of_studies import after_blind_score

    print(score_study(directory, verdicts, as_json=as_json, partial=partial), end="")
    if not as_json:
        print_next(after_blind_score(directory))
