"""Recordings: made, rewritten, shown."""

import json
from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.root import ConfigArgument, JsonOption, app


@app.command(epilog="Example: piezod record config/bench.yaml --excitation varying-triangles -o varying.csv")
def record(
    config: ConfigArgument,
    excitation: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="constant-triangles, varying-triangles, staircase-minor-loops-multisine, or a recording whose voltage "
            "is driven again.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="REC", help="The recording to write; its suffix says how.")
    ],
    peak: Annotated[
        float | None, typer.Option(metavar="V", help="Highest voltage; the limit's, or the recording's, when left out.")
    ] = None,
    frequency: Annotated[float, typer.Option(metavar="HZ", min=1e-4, help="Of one full triangle.")] = 0.1,
    periods: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Triangles: 5, or repeats of the whole: 1, when left out.")
    ] = None,
    reset_cycle: Annotated[bool, typer.Option(help="Drive 0 -> highest -> 0 first.")] = False,
) -> None:
    """Drive an excitation through the bench and record what it answers."""
    from piezod.commissioning.record import excitation_s
    from piezod.commissioning.record import record as record_excitation
    from piezod.excitation import usual_periods
    from piezod.recording import check_target, write_recording
    from piezod.report.progress import progress

    check_target(output)
    periods = periods or usual_periods(excitation)
    with progress(f"recording {excitation}", excitation_s(excitation, frequency, periods)) as show:
        recording, outcome = record_excitation(
            config,
            excitation,
            peak_V=peak,
            frequency_Hz=frequency,
            periods=periods,
            reset_cycle=reset_cycle,
            on_rows=show,
        )
    write_recording(recording, output)
    missing = f", {outcome.missed} ticks missed" if outcome.missed else ""
    print(f"{output}: {recording.time_s.size} samples, {recording.time_s[-1]:.1f} s{missing}")


@app.command(epilog="Example: piezod convert varying.csv -o varying.mat")
def convert(
    recording: Annotated[Path, typer.Argument(metavar="IN", help="csv, sqlite, h5, mat, tdms, parquet, mf4.")],
    output: Annotated[Path, typer.Option("-o", metavar="OUT", help="As above; its suffix says how.")],
    as_json: JsonOption = False,
) -> None:
    """Rewrite a recording in another format."""
    from piezod.identify.intake import check_result
    from piezod.recording import check_target, read_recording, write_recording

    check_target(output)
    check_result(output, [recording])
    read = read_recording(recording)
    write_recording(read, output)
    if as_json:
        said = {"schema": "piezod.convert/1", "file": str(output), "samples": read.time_s.size}
        print(json.dumps(said | {"columns": ["time_s", *read.channels]}, indent=2))
    else:
        print(f"{output}: {read.time_s.size} samples of time_s, {', '.join(read.channels)}")


@app.command(epilog="Example: piezod report /var/lib/piezod/recordings/press-000007.sqlite -o run.html")
def report(
    recording: Annotated[Path, typer.Argument(metavar="REC", help="What the recorder kept, or any other recording.")],
    output: Annotated[Path, typer.Option("-o", metavar="FILE", help="The page to write.")],
    as_json: JsonOption = False,
) -> None:
    """Make the page of a run from its recording, also of one that was cut off."""
    from piezod.identify.intake import check_result
    from piezod.recording import read_recording
    from piezod.report.run import run_figures, write_run_page

    check_result(output, [recording])
    read = read_recording(recording)
    figures = run_figures(read)
    write_run_page(output, read, figures)
    print(json.dumps(figures.as_dict(), indent=2) if as_json else f"{figures.sentence}\npage: {output.resolve()}")
