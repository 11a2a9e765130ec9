"""The concealed study."""

from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.root import JsonOption, app
from piezod.errors import UsageError

blind = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="The concealed study: make, run, score.")
app.add_typer(blind, name="blind")

StudyArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Of the study.")]


@blind.command("make", epilog="Example: piezod blind make study --cases 300")
def blind_make(
    directory: StudyArgument,
    cases: Annotated[int, typer.Option(metavar="N", min=1, help="How many.")],
    seed: Annotated[
        int | None, typer.Option(min=0, help="The same seed, the same study; else the operating system's.")
    ] = None,
    kind: Annotated[
        str | None, typer.Option(metavar="KIND", help="null, single, pair, triple or foreign; all when left out.")
    ] = None,
    effect: Annotated[
        str | None, typer.Option(metavar="NAME", help="In every case that is no null; each in turn when left out.")
    ] = None,
    strength: Annotated[
        float | None, typer.Option(metavar="X", help="In parts of the noise; 0.8, 4 and 20 in turn when left out.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; as many as cores when left out.")] = None,
) -> None:
    """Draw cases of a plant that shares no code with this program, and seal the truth."""
    from piezod.blind.local import cores
    from piezod.blind.plant import make_study
    from piezod.report.progress import steps

    options = {"seed": seed, "kind": kind, "effect": effect, "strength": strength, "jobs": jobs or cores()}
    with steps() as show:
        make_study(directory, cases, options, lambda drawn: show("drawing", drawn / cases))
    print(f"{directory}: {cases} cases, truth sealed")


@blind.command("run", epilog="Example: piezod blind run study -o verdicts --scheduler tcp://10.0.0.1:8786")
def blind_run(
    directory: StudyArgument,
    output: Annotated[
        Path, typer.Option("-o", metavar="VERDICTS", help="Cases that have a verdict there are left out.")
    ],
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; as many as cores when left out.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Of a Dask cluster, whose workers do it instead.")
    ] = None,
    only: Annotated[str | None, typer.Option(metavar="CASE,...", help="Such as case_0001,case_0007.")] = None,
) -> None:
    """Identify, diagnose and simulate every case of a study; a run that was stopped goes on where it was."""
    from piezod.blind.run import run_study
    from piezod.blind.verdict import Verdict
    from piezod.report.progress import steps

    if jobs is not None and scheduler is not None:
        raise UsageError("--jobs is for this machine, --scheduler for a cluster: give one of them")
    with steps(show_after_s=0.0) as show:

        def tell(verdict: Verdict | None, done: int, of: int) -> None:
            if verdict is not None and verdict.failed is not None:
                print(f"{verdict.name} failed: {verdict.failed}", flush=True)
            show(f"{done} of {of} cases", done / of)

        wanted = tuple(only.split(",")) if only else ()
        ran = run_study(directory, output, jobs=jobs, scheduler=scheduler, only=wanted, on_verdict=tell)
    print(f"{output}: {ran.judged} cases judged, {ran.failed} failed, {ran.already} were there already")
    raise typer.Exit(1 if ran.failed else 0)


@blind.command("score", epilog="Example: piezod blind score study verdicts")
def blind_score(
    directory: StudyArgument,
    verdicts: Annotated[Path, typer.Argument(metavar="VERDICTS", help="What piezod blind run wrote.")],
    partial: Annotated[bool, typer.Option("--partial", help="Leave out cases that were not run.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Open the sealed truth and say how good the verdicts are."""
    from piezod.blind.plant import score_study

    print(score_study(directory, verdicts, as_json=as_json, partial=partial), end="")
