"""`piezod history`: the models of a bench over time."""

import json
from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.root import JsonOption, app


@app.command(epilog="Example: piezod history models diagnosis/model.yaml --output history.html")
def history(
    models: Annotated[
        list[Path], typer.Argument(metavar="MODEL_OR_FOLDER...", help="Model files, or folders with models.")
    ],
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="PAGE", help="Page to write (html).")] = None,
    table: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Table to write.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the models of a bench over time: lineage, parameters with intervals, and changes.

    Of a folder, the models in it and in its subfolders are read, such as folders that diagnose has written.
    """
    from piezod.recording import check_page

    check_page(output)
    check_page(table)
    from piezod.history.timeline import timeline_of
    from piezod.history.words import verdict_of

    timeline = timeline_of(models)
    if table is not None or output is not None or not as_json:
        from piezod.report.history import history_text, write_history_csv, write_history_page

        if table is not None:
            write_history_csv(table, timeline)
        if output is not None:
            write_history_page(output, timeline)
    print(json.dumps(timeline.as_dict(verdict_of(timeline)), indent=2) if as_json else history_text(timeline))
