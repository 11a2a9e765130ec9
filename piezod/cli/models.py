"""Commands for models: identify, simulate, compare with measurements, validate on the bench."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
    check_readable,
)
from piezod.errors import UsageError

if TYPE_CHECKING:
    from piezod.api.results import Identified
    from piezod.estimation.recordings.intake import LoadedRecording
    from piezod.model import Model
    from piezod.recording import TextOptions
    from piezod.report.next_step import NextStep

ModelOption = Annotated[Path, typer.Option("--model", metavar="MODEL", help="Model file.")]
PageOption = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Page to write.")]
StartWindowOption = Annotated[
    float, typer.Option(metavar="S", min=0.0, help="First seconds, from which the initial state is estimated.")
]


@app.command(epilog="Example: piezod identify varying.csv constant.csv -o model.yaml --report report")
def identify(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="REC...", help="Recordings: csv, sqlite, h5, mat, tdms, parquet, mf4.")
    ],
    model: Annotated[Path, typer.Option("-o", metavar="MODEL", help="Model file to write.")],
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for identification.html.")] = None,
    input_column: Annotated[
        str | None, typer.Option("--input", metavar="COLUMN", help="Default: voltage_V, or what the names tell.")
    ] = None,
    output_column: Annotated[
        str | None, typer.Option("--output", metavar="COLUMN", help="Default: force_N, or what the names tell.")
    ] = None,
    plays: Annotated[
        int | None, typer.Option(min=1, max=100, help="Number of plays; default: the fewest that fit to the noise.")
    ] = None,
    dead_zones: Annotated[
        int | None, typer.Option(min=0, max=30, help="Number of dead zones; default: likewise.")
    ] = None,
    orders: Annotated[
        bool, typer.Option("--orders", help="Fit every pair of numbers and show their errors on held-out data.")
    ] = False,
    variant: Annotated[
        str, typer.Option(metavar="A|B", help="A: no negative weight, with --orders; B: no negative partial sum.")
    ] = "B",
    fit_share: Annotated[
        float,
        typer.Option(
            help="With given numbers or --orders: share of each recording that is fitted; the rest is held out."
        ),
    ] = 0.7,
    name: Annotated[str, typer.Option(help="Name of the model.")] = "stack",
    columns: ColumnsOption = None,
    rate_hz: RateOption = None,
    decimal: DecimalOption = None,
    scale: ScaleOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Identify a model from recordings."""
    from piezod.recording import TextOptions

    if variant not in ("A", "B"):
        raise UsageError(f"--variant is '{variant}', must be A or B")
    more: dict[str, Any] = {"plays": plays, "zones": dead_zones, "orders": orders, "variant": variant}
    more |= {"fit_share": fit_share, "name": name}
    text = TextOptions.of(columns, rate_hz, decimal, scale)
    result, step = identify_files(recordings, model, report, (input_column, output_column), text, force=force, **more)
    from piezod.report.identification import identification_text

    print_result(result.as_dict(), identification_text(result.identification), step, as_json=as_json)
    if not result.useful:
        raise typer.Exit(1)


def identify_files(
    recordings: list[Path],
    model: Path,
    report: Path | None,
    columns: tuple[str | None, str | None] = (None, None),
    text: "TextOptions | None" = None,
    *,
    force: bool = False,
    **options: Any,  # noqa: ANN401  # fields of `identify.options.Options`
) -> "tuple[Identified, NextStep]":
    """Identify a model, and write its file and its page.

    Parameters
    ----------
    report
        Folder for identification.html; None: no page.
    columns
        Names of input and output; None: from the names in the file.
    text
        Layout of text files as the user states it.
    """
    from piezod.recording import TextOptions, column_names
    from piezod.recording.conversion import choose_columns
    from piezod.recording.files import check_output_path
    from piezod.recording.targets import check_absent, check_folder, check_model_target, check_page

    check_output_path(model, recordings)
    check_model_target(model)
    check_page(model)
    check_absent(model, force=force)
    check_folder(report)
    names = column_names(recordings[0], text or TextOptions())
    named = {"input": columns[0], "output": columns[1]}
    input_name, output_name, chosen = choose_columns(recordings[0], names, named)
    from piezod.api.functions import identified  # a wrong file is refused before the libraries are there
    from piezod.identify.options import Options
    from piezod.report.identification import next_after, write_identification_page
    from piezod.report.progress import steps

    with steps() as show:
        result = identified(recordings, Options(input=input_name, output=output_name, **options), chosen, show, text)
    step = next_after(result.identification, recordings, model)
    if report is not None:
        write_identification_page(report / "identification.html", result.identification, result.recordings, step)
    result.model.save(model)
    return result, step


@app.command(epilog="Example: piezod simulate varying.csv --model model.yaml -o simulated.csv")
def simulate(
    recording: Annotated[Path, typer.Argument(metavar="REC", help="Recording that holds the input.")],
    model: ModelOption,
    output: Annotated[Path, typer.Option("-o", metavar="OUT", help="File for time_s and the simulated output.")],
    start_window: StartWindowOption = 1.0,
    condition: Annotated[
        str | None, typer.Option("--where", metavar="COLUMN=VALUE", help="Compare only the samples with this value.")
    ] = None,
    leave_out: Annotated[
        list[str] | None,
        typer.Option("--leave-out", metavar="FROM:TO", help="Seconds that are not compared; repeatable."),
    ] = None,
    columns: ColumnsOption = None,
    rate_hz: RateOption = None,
    decimal: DecimalOption = None,
    scale: ScaleOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a model over the input of a recording, in free run; compare with its output, if it has one."""
    from piezod.recording import TextOptions, write_recording
    from piezod.recording.files import check_recording_target
    from piezod.recording.targets import check_absent

    text = TextOptions.of(columns, rate_hz, decimal, scale)
    check_recording_target(output, [recording])
    check_absent(output, force=force)
    check_readable(recording, model, text)  # a wrong file is refused before the libraries are there
    from piezod.estimation.recordings.chosen_samples import outside, where
    from piezod.identify.simulation import simulate_recording
    from piezod.model import load_model

    plant = load_model(model)
    loaded = _loaded(recording, plant, condition, text)
    chosen = outside(loaded.recording, leave_out or ())
    if condition:
        chosen &= where(loaded.recording, condition)
    simulation = simulate_recording(plant, loaded.recording, start_window, chosen, loaded.sha256)
    write_recording(simulation.recording, output)
    figures = simulation.agreement
    from piezod.report.next_step.of_models import after_simulate

    step = after_simulate(
        recording,
        model,
        error=None if figures is None else figures.rms_tared,
        noise=None if plant.information is None else plant.information.noise,
    )
    compared = None if figures is None else asdict(figures) | {"unit": plant.output.unit}
    source = loaded.source.model_dump(include={"path", "sha256", "samples", "read_as"})
    content = {"schema": "piezod.simulation/1", "start": simulation.start, "compared": compared}
    words = "" if figures is None else f"; {figures.words(plant.output.unit)}"
    lines = [f"{output}: {loaded.source.samples} samples; {simulation.start}{words}"]
    lines += [f"note: {note}" for note in loaded.notes]
    print_result(content | {"recording": source, "notes": loaded.notes}, "\n".join(lines), step, as_json=as_json)


def _loaded(recording: Path, plant: "Model", condition: str | None, text: "TextOptions") -> "LoadedRecording":
    """Recording with the columns of a model and of a condition `COLUMN=VALUE`."""
    from piezod.estimation.recordings.intake import load_for_simulation
    from piezod.estimation.recordings.layout import layout_of
    from piezod.report.progress import steps

    layout = layout_of(recording, plant, text)
    column, equals, _ = (condition or "").partition("=")
    columns = [column] if equals else []
    with steps() as show:
        return load_for_simulation(recording, plant.input.channel, plant.output.channel, columns, show, layout)


@app.command(epilog="Example: piezod compare work.csv simulated.csv --model model.yaml --report comparison.html")
def compare(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="REC [REC...]", help="Measured recording, then simulated ones; or two model files."),
    ],
    model: Annotated[
        list[Path] | None, typer.Option(metavar="MODEL", help="Model to simulate over the measured input; repeatable.")
    ] = None,
    output_column: Annotated[
        str | None, typer.Option("--output", metavar="COLUMN", help="Default: the column of the model, or force_N.")
    ] = None,
    start_window: StartWindowOption = 1.0,
    report: PageOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare a measured output with simulated ones and with models in free run; fit as in MATLAB's compare.

    Two model files are compared parameter by parameter.
    """
    from piezod.recording import column_names
    from piezod.recording.targets import check_page

    check_page(report)
    if len(recordings) == 2 and not model and all(path.suffix in (".yaml", ".yml") for path in recordings):
        from piezod.history.comparison import compare_models

        models = compare_models(*recordings)
        if report is not None or not as_json:
            from piezod.report.history import model_comparison_text, write_model_comparison_page

            if report is not None:
                write_model_comparison_page(report, models)
        print(json.dumps(models.as_dict(), indent=2) if as_json else model_comparison_text(models))
        return
    if len(recordings) > 1 or model:  # else the missing comparison is reported first
        column_names(recordings[0])  # a wrong file is refused before the libraries are there
    from piezod.report.output_comparison import (
        compare_files,
        comparison_as_dict,
        comparison_text,
        write_comparison_page,
    )

    comparison = compare_files(recordings[0], recordings[1:], model or (), output_column, start_window)
    from piezod.report.next_step.of_models import after_compare

    best = comparison.best
    is_model = best.path in (model or ())
    step = after_compare(recordings[0], best.path, is_model=is_model, error=best.agreement.rms, noise=comparison.noise)
    if report is not None:
        write_comparison_page(report, comparison, step)
    print_result(comparison_as_dict(comparison), comparison_text(comparison), step, as_json=as_json)


@app.command(epilog="Example: piezod resid work.csv --model model.yaml --report residual.html")
def resid(
    recording: Annotated[Path, typer.Argument(metavar="REC", help="Measured recording.")],
    model: ModelOption,
    lags: Annotated[int, typer.Option(min=1, max=10_000, help="Number of lags [samples].")] = 25,
    start_window: StartWindowOption = 1.0,
    report: PageOption = None,
    as_json: JsonOption = False,
) -> None:
    """Test whether a model's residual is white and independent of the input, with the bounds of MATLAB's resid."""
    from piezod.recording import column_names
    from piezod.recording.targets import check_page

    check_page(report)
    column_names(recording)  # a wrong file is refused before the libraries are there
    from piezod.estimation.recordings.intake import load_for_simulation
    from piezod.model import load_model
    from piezod.report.whiteness import (
        residual_of,
        whiteness_as_dict,
        whiteness_test,
        whiteness_text,
        write_whiteness_page,
    )

    plant = load_model(model)
    loaded = load_for_simulation(recording, plant.input.channel, plant.output.channel)
    residual = residual_of(plant, loaded.recording, start_window, loaded.sha256)
    test = whiteness_test(loaded.recording, residual, plant.input.channel, lags)
    unit = plant.output.unit
    from piezod.report.next_step.of_models import after_resid

    step = after_resid(recording, model, white=not test.auto_outside, independent=not test.cross_outside)
    if report is not None:
        write_whiteness_page(report, test, loaded.recording, residual, unit, step)
    content = whiteness_as_dict(test, loaded.recording, plant.name, unit)
    print_result(content, whiteness_text(test, unit), step, as_json=as_json)


@app.command(epilog="Example: piezod validate config/bench.yaml --model a.yaml --model b.yaml --report validation.html")
def validate(
    config: ConfigArgument,
    model: Annotated[
        list[Path],
        typer.Option(metavar="MODEL", help="Model to test; repeatable. The first one also gives the plain gain."),
    ],
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Page with all loops to write.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Follow six triangular force references without and with each model; report the better model."""
    raise typer.Exit(validate_models(config, model, report, as_json=as_json))


def validate_models(
    config: Path, models: list[Path], report: Path | None, *, as_json: bool, emulated: bool = False
) -> int:
    """Follow the references with each model and print the result; return the exit code.

    Parameters
    ----------
    report
        Page to write; None: no page.
    emulated
        Whether the bench ends with the command.
    """
    from piezod.config import load_bench
    from piezod.recording.targets import check_page

    check_page(report)
    load_bench(config)  # a wrong file is refused before the libraries are there
    from piezod.commissioning.validate import plan_validation, run_validation
    from piezod.daemon.run import rows_are_saved
    from piezod.report.next_step.of_benches import after_validate
    from piezod.report.progress import progress
    from piezod.report.tracking.validation import evaluate_validation, validation_text, write_validation_page

    plan = plan_validation(config, models)
    with progress(f"{len(plan.segments)} runs", plan.duration_s) as show:
        result = run_validation(plan, show)
    verdict = evaluate_validation(plan.references, plan.compensations, plan.range_N, result.recordings, result.outcome)
    files = dict(zip(plan.compensations[1:], models, strict=True))
    noises = verdict.scores[verdict.better].rms / verdict.noise_N if verdict.better and verdict.noise_N else None
    step = after_validate(
        None if emulated else config,
        files[verdict.better] if verdict.better else None,
        better_than_none=verdict.better_than_none,
        noises=noises,
        complete=verdict.complete,
    )
    if as_json:
        print(json.dumps(verdict.as_dict() | {"next_step": step.as_dict()}, indent=2))
    else:
        print(validation_text(verdict))
    if report is not None:
        write_validation_page(report, verdict, result.recordings, step)
        if not as_json:
            print(f"page: {report.resolve()}")
    if not as_json:
        print_next(step)
    if verdict.complete:
        rows_are_saved()
    return 0 if verdict.complete else 1
