"""Commands for recordings: record, convert, report."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from piezod.cli import INTERRUPTED
from piezod.cli.output import print_next, print_result
from piezod.cli.root import (
    ColumnsOption,
    ConfigArgument,
    DecimalOption,
    ForceOption,
    JsonOption,
    RateOption,
    ScaleOption,
    app,
)


@app.command(epilog="Example: piezod record config/bench.yaml --excitation varying-triangles -o varying.csv")
def record(
    config: ConfigArgument,
    excitation: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="constant-triangles, varying-triangles, staircase-minor-loops-multisine, or a recording whose voltage "
            "is repeated.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="REC", help="Recording to write; the suffix determines the format."),
    ],
    peak: Annotated[
        float | None, typer.Option(metavar="V", help="Highest voltage; default: the limit, or that of the recording.")
    ] = None,
    frequency: Annotated[float, typer.Option(metavar="HZ", min=1e-4, help="Frequency of a triangle.")] = 0.1,
    periods: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="Triangles, default 5; or repetitions of a recording, default 1."),
    ] = None,
    reset_cycle: Annotated[bool, typer.Option(help="First drive 0 -> highest voltage -> 0.")] = False,
    force: ForceOption = False,
) -> None:
    """Drive an excitation through the bench and record the response.

    Ctrl-C ramps down, writes the recording so far, marked as incomplete, and ends with exit code 130.
    """
    record_to_file(config, excitation, output, peak, frequency, periods, reset_cycle=reset_cycle, force=force)
    from piezod.config import load_bench, model_path
    from piezod.report.next_step.of_benches import after_record

    model = model_path(load_bench(config), config)
    print_next(after_record(output, config, model, model_exists=model.exists()))


def record_to_file(
    config: Path,
    excitation: str,
    output: Path,
    peak: float | None = None,
    frequency: float = 0.1,
    periods: int | None = None,
    *,
    reset_cycle: bool = False,
    force: bool = False,
) -> None:
    """Drive an excitation, write the recording and print one line about it.

    Parameters
    ----------
    peak, frequency, periods, reset_cycle, force
        As the options of `piezod record`: peak [V], frequency [Hz].

    Raises
    ------
    typer.Exit
        Ctrl-C ended the drive.
    """
    from piezod.commissioning.record import excitation_duration_s, record_excitation
    from piezod.daemon.run import rows_are_saved
    from piezod.errors import CheckFailedError
    from piezod.excitation import default_periods
    from piezod.recording import write_recording
    from piezod.recording.files import check_recording_target
    from piezod.recording.targets import check_absent
    from piezod.report.progress import progress

    check_recording_target(output)
    check_absent(output, force=force)
    periods = periods or default_periods(excitation)
    with progress(f"recording {excitation}", excitation_duration_s(excitation, frequency, periods)) as show:
        recording, outcome = record_excitation(
            config,
            excitation,
            peak_V=peak,
            frequency_Hz=frequency,
            periods=periods,
            reset_cycle=reset_cycle,
            on_rows=show,
        )
    if not recording.time_s.size:
        rows_are_saved()
        text = f"{recording.metadata.get('incomplete', 'no sample')}; {output} is not written"
        if outcome.fault:
            raise CheckFailedError(f"the recording ended before the excitation began: {text}")
        print(f"stopped before the excitation began; {output} is not written", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    write_recording(recording, output)
    rows_are_saved()
    missing = f", {outcome.missed} ticks missed" if outcome.missed else ""
    print(f"{output}: {recording.time_s.size} samples, {recording.time_s[-1]:.1f} s{missing}")
    if outcome.fault:
        raise CheckFailedError(f"{output}: the recording ended early: {recording.metadata['incomplete']}")
    if outcome.stopped:
        print(f"{output}: incomplete, {recording.metadata['incomplete']}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)


@app.command(epilog="Example: piezod convert varying.csv -o varying.mat")
def convert(
    recording: Annotated[Path, typer.Argument(metavar="IN", help="Any text, sqlite, h5, mat, tdms, parquet, mf4.")],
    output: Annotated[Path, typer.Option("-o", metavar="OUT", help="Likewise; the suffix determines the format.")],
    columns: ColumnsOption = None,
    rate_hz: RateOption = None,
    decimal: DecimalOption = None,
    scale: ScaleOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Rewrite a recording in another format."""
    from piezod.recording import TextOptions
    from piezod.recording.files import check_recording_target
    from piezod.recording.files import convert as convert_file
    from piezod.recording.formats.repairs import repair_notes
    from piezod.recording.targets import check_absent
    from piezod.report.next_step.of_benches import after_convert

    check_recording_target(output, [recording])
    check_absent(output, force=force)
    converted = convert_file(recording, output, TextOptions.of(columns, rate_hz, decimal, scale))
    names = ["time_s", *converted.channels]
    step = after_convert(output, has_command={"voltage_V", "force_N"} <= set(names))
    understood, repairs = converted.metadata.get("understood", ""), repair_notes(converted.metadata)
    content = {"schema": "piezod.convert/1", "file": str(output), "samples": converted.time_s.size}
    content |= {"columns": names, "understood": understood, "notes": repairs}
    lines = [f"{output}: {converted.time_s.size} samples of {', '.join(names)}"]
    lines += [f"read as: {understood}"] if understood else []
    print_result(content, "\n".join([*lines, *(f"note: {note}" for note in repairs)]), step, as_json=as_json)


@app.command(epilog="Example: piezod report /var/lib/piezod/recordings/press-000007.sqlite -o run.html")
def report(
    recording: Annotated[Path, typer.Argument(metavar="REC", help="Recording of the daemon, or another one.")],
    output: Annotated[Path, typer.Option("-o", metavar="FILE", help="Page to write.")],
    as_json: JsonOption = False,
) -> None:
    """Make the page of a run from its recording, complete or interrupted."""
    from piezod.recording import read_recording
    from piezod.recording.files import check_output_path
    from piezod.recording.targets import check_page

    check_output_path(output, [recording])
    check_page(output)
    run = read_recording(recording)  # a wrong file is refused before the libraries are there
    from piezod.report.run import next_after, run_figures, write_run_page

    figures = run_figures(run)
    step = next_after(run, figures)
    write_run_page(output, run, figures, step)
    text = f"{figures.sentence}\npage: {output.resolve()}"
    print_result(figures.as_dict(), text, step, as_json=as_json)
