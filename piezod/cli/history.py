"""`piezod history`: the models of a bench over time."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.output import print_next, print_result
from piezod.cli.root import JsonOption, app
from piezod.errors import UsageError

FOLDER = "history"  # in an archive: default folder of the diagnoses and pages


@app.command(epilog="Example: piezod history models diagnosis/model.yaml --output history.html")
def history(
    models: Annotated[
        list[Path],
        typer.Argument(
            metavar="MODEL_OR_FOLDER...", help="Model files, folders with models, or archives of recordings."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PAGE", help="Page to write (html); of an archive: folder to write."),
    ] = None,
    table: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Table to write.")] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="For an archive: number of processes; default: one per core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="For an archive: scheduler of a Dask cluster that diagnoses."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the models of a bench over time: lineage, parameters with intervals, and changes.

    Of a folder, the models in it and in its subfolders are read, such as folders that diagnose has written. Their
    verdicts are listed too.

    An archive has a folder for each bench, with its model.yaml and its recordings. Recordings that are not diagnosed
    yet are diagnosed, each with the model that the recording before it gave. A stopped run continues.
    """
    from piezod.history.archive import is_archive

    if any(is_archive(path) for path in models):
        if table is not None:
            raise UsageError("--csv is for models, an archive has --json: give one of them")
        _archive(models, output, jobs, scheduler, as_json=as_json)
        return
    if jobs is not None or scheduler is not None:
        raise UsageError("--jobs and --scheduler are for archives: name a folder of benches with recordings")
    _models(models, output, table, as_json=as_json)


def _models(models: list[Path], output: Path | None, table: Path | None, *, as_json: bool) -> None:
    """Compare the models, write page and table, and print the history."""
    from piezod.recording.targets import check_page

    check_page(output)
    check_page(table)
    from piezod.history.checks import checks_text, find_checks
    from piezod.history.timeline import timeline_of
    from piezod.history.trends import estimates_of, trends_of
    from piezod.history.words import step_clauses, verdict_of
    from piezod.report.next_step.of_studies import after_history

    timeline, checks = timeline_of(models), find_checks(models)
    estimates = estimates_of([check.dated for check in checks])
    trends = trends_of(estimates)
    newest = timeline.steps[-1]
    verdict = checks[-1].verdict if checks else None
    step = after_history(newest.entry.paths[0], changed=bool(step_clauses(newest)), verdict=verdict)
    if table is not None or output is not None or not as_json:
        from piezod.report.history import history_text, write_history_csv, write_history_page

        if table is not None:
            write_history_csv(table, timeline)
        if output is not None:
            write_history_page(output, timeline, trends=trends, estimates=estimates, step=step)
    if as_json:
        more = {
            "checks": [check.as_dict() for check in checks],
            "trends": [trend.as_dict() for trend in trends],
            "next_step": step.as_dict(),
        }
        print(json.dumps(timeline.as_dict(verdict_of(timeline, trends)) | more, indent=2))
    else:
        print("\n".join(filter(None, [history_text(timeline, trends), checks_text(checks)])))
        print_next(step)


def _archive(
    archives: list[Path], output: Path | None, jobs: int | None, scheduler: str | None, *, as_json: bool
) -> None:
    """Diagnose the recordings that are not diagnosed yet, write the pages, and print the fleet."""
    from piezod.history.archive import find_benches
    from piezod.history.archive_run import diagnose_archive
    from piezod.history.fleet import Fleet
    from piezod.recording.targets import check_folder
    from piezod.report.fleet import fleet_text, next_after, write_fleet_pages
    from piezod.report.progress import steps

    if jobs is not None and scheduler is not None:
        raise UsageError("--jobs is for this machine, --scheduler for a cluster: give one of them")
    folder = output or archives[0] / FOLDER
    check_folder(folder)
    benches = find_benches(archives)
    with steps(show_after_s=0.0) as show:

        def report(failed: str | None, done: int, of: int) -> None:
            if failed is not None:
                print(f"{failed}", file=sys.stderr, flush=True)
            show(f"{done} of {of} recordings", done / of)

        runs = diagnose_archive(benches, folder, jobs=jobs, scheduler=scheduler, on_recording=report)
        fleet = Fleet.of(runs)
        show("drawing the pages", None)
        step = next_after(fleet, archives, folder)
        write_fleet_pages(folder, fleet, step)
    text = f"{fleet_text(fleet)}\npages: {folder / 'fleet.html'}"
    print_result(fleet.as_dict(), text, step, as_json=as_json)
