"""`piezod diagnose` and `piezod effects`: physical effects that a model lacks."""

from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.output import print_result
from piezod.cli.root import (
    ColumnsOption,
    DecimalOption,
    ForceOption,
    JsonOption,
    RateOption,
    ScaleOption,
    app,
    check_readable,
)
from piezod.errors import UsageError


@app.command(epilog="Example: piezod diagnose work.csv --model model.yaml -o diagnosis")
def diagnose(
    output: Annotated[
        Path, typer.Option("-o", metavar="DIR", help="Folder for findings.json, model.yaml and report.html.")
    ],
    recordings: Annotated[list[Path] | None, typer.Argument(metavar="REC...", help="Recordings to diagnose.")] = None,
    model: Annotated[Path | None, typer.Option("--model", metavar="MODEL")] = None,
    from_bench: Annotated[
        Path | None,
        typer.Option(
            metavar="CONFIG", help="The recording that the daemon saved when this bench drifted from its model."
        ),
    ] = None,
    from_archive: Annotated[
        Path | None,
        typer.Option(
            metavar="CONFIG", help="The newest drive in the recorder's files, into a folder of its own in DIR."
        ),
    ] = None,
    input_column: Annotated[
        str | None, typer.Option("--input", metavar="COLUMN", help="Default: the column of the model.")
    ] = None,
    output_column: Annotated[str | None, typer.Option("--output", metavar="COLUMN", help="Likewise.")] = None,
    hold_out: Annotated[
        list[Path] | None,
        typer.Option(metavar="REC", help="Recording to compare both models on, not used for the fit; repeatable."),
    ] = None,
    condition: Annotated[
        str | None, typer.Option("--where", metavar="COLUMN=VALUE", help="Use only the samples with this value.")
    ] = None,
    replay: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File for every hypothesis that was tried (JSON).")
    ] = None,
    within: Annotated[
        float | None,
        typer.Option(metavar="S", min=1.0, help="Seconds after which it ends with the best answer so far."),
    ] = None,
    columns: ColumnsOption = None,
    rate_hz: RateOption = None,
    decimal: DecimalOption = None,
    scale: ScaleOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find the effects that a model lacks: place, effect, confidence, and the extended model."""
    from piezod.recording import TextOptions
    from piezod.recording.targets import check_folder, check_page

    recordings = list(recordings or ())
    if from_archive is not None:
        from piezod.commissioning.archive_check import prepare_check

        if recordings or model is not None or from_bench is not None:
            raise UsageError(
                "--from-archive determines recording and model: give neither REC, --model nor --from-bench"
            )
        saved, model, output = prepare_check(from_archive, output)
        recordings = [saved]
    check_folder(output, ("findings.json", "model.yaml"), force=force)
    check_page(replay)
    text = TextOptions.of(columns, rate_hz, decimal, scale)
    if from_bench is not None:
        from piezod.daemon.drift import find_drift_recording

        if recordings or model is not None:
            raise UsageError("--from-bench determines recording and model: give neither REC nor --model")
        saved, model = find_drift_recording(from_bench)
        recordings = [saved]
    if model is None or not recordings:
        raise UsageError("REC... or --model is missing: give both, or --from-bench or --from-archive CONFIG")
    for path in (*recordings, *(hold_out or ())):
        check_readable(path, model, text)  # a wrong file is refused before the libraries are there
    from piezod.diagnose.command import diagnose_files
    from piezod.report.progress import steps

    with steps() as show:
        diagnosis = diagnose_files(
            recordings, model, output, input_column, output_column, show, hold_out or (), condition, text, within
        )
        if replay is not None:
            from piezod.diagnose.selection.replay import write_replay

            write_replay(replay, diagnosis.attempts)
        from piezod.report.diagnosis.page import write_diagnosis_page
        from piezod.report.diagnosis.terminal import findings_text, next_after

        step = next_after(diagnosis, recordings, model, output, from_bench)
        show("drawing the report", None)
        write_diagnosis_page(output / "report.html", diagnosis, step)
    print_result(diagnosis.findings.as_dict(), findings_text(diagnosis, output), step, as_json=as_json)


@app.command("testable", epilog="Example: piezod testable work.csv --model model.yaml")
def what_is_testable(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC...", help="Recordings, or plans of them.")],
    model: Annotated[Path, typer.Option("--model", metavar="MODEL", help="Identified model.")],
    next_file: Annotated[
        Path | None,
        typer.Option("--next", metavar="FILE", help="File for the drive that separates the open pairs best."),
    ] = None,
    longest: Annotated[float, typer.Option(metavar="S", min=6.0, max=600.0, help="Its longest duration.")] = 60.0,
    columns: ColumnsOption = None,
    rate_hz: RateOption = None,
    decimal: DecimalOption = None,
    scale: ScaleOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Tell which effects recordings could show, and which they cannot separate from each other."""
    from piezod.recording import TextOptions, write_recording
    from piezod.recording.files import check_recording_target
    from piezod.recording.targets import check_absent

    if next_file is not None:
        check_recording_target(next_file, recordings)
        check_absent(next_file, force=force)
    text = TextOptions.of(columns, rate_hz, decimal, scale)
    for path in recordings:
        check_readable(path, model, text)  # a wrong file is refused before the libraries are there
    from piezod.diagnose.experiment.isolability import isolability
    from piezod.diagnose.experiment.planning import next_experiment
    from piezod.estimation.recordings.layout import layout_of
    from piezod.estimation.recordings.sources import past_sources, read_source
    from piezod.model import load_model
    from piezod.report.isolability import experiment_as_dict, experiment_text, isolability_as_dict, isolability_text
    from piezod.report.progress import steps

    plant = load_model(model)
    with steps() as show:
        show("reading", None)
        names = plant.input.channel, plant.output.channel
        sources = [read_source(path, "recording", names, text=layout_of(path, plant, text)) for path in recordings]
        past, notes = past_sources(plant, model.parent, sources)
        show("comparing effects", None)
        result = isolability(plant, sources, past)
        show("looking for the next experiment", None)
        planned = None if next_file is None else next_experiment(plant, sources, past, result, longest)
    if planned is not None and next_file is not None:
        write_recording(planned.recording(plant.input.channel), next_file)
    unit = plant.output.unit
    from piezod.report.next_step.of_models import after_testable

    step = after_testable(
        recordings, model, next_file, planned=planned is not None, open_pairs=bool(result.groups() or result.unseen)
    )
    content, lines = isolability_as_dict(result, unit), [isolability_text(result, unit)]
    lines += [f"note: {note}" for note in notes]
    if next_file is not None:
        content["next"] = None if planned is None else experiment_as_dict(planned)
        lines.append(experiment_text(planned, str(next_file)))
    print_result(content, "\n".join(lines), step, as_json=as_json)


@app.command(epilog="Example: piezod effects creep")
def effects(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Effect to describe.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the physical effects that a diagnosis can find, or describe one of them."""
    from piezod.effects import EFFECTS
    from piezod.report.effects import effect_as_dict, effect_named, effect_page, effects_table
    from piezod.report.next_step.of_studies import after_effects

    chosen = None if name is None else effect_named(name)
    shown = list(EFFECTS.values()) if chosen is None else [chosen]
    content = {"schema": "piezod.effects/1", "effects": [effect_as_dict(effect) for effect in shown]}
    text = effects_table() if chosen is None else effect_page(chosen)
    print_result(content, text, after_effects(name, next(iter(EFFECTS))), as_json=as_json)
