"""Commands that drive a bench several times: commission, investigate."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.models import identify_files, validate_models
from piezod.cli.output import print_next
from piezod.cli.recordings import record_to_file
from piezod.cli.root import ForceOption, JsonOption, app
from piezod.errors import UsageError

OptionalConfig = Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="Bench configuration.")]
EmulatedOption = Annotated[
    str | None,
    typer.Option(metavar="SCENARIO", help="Emulated bench that runs faster than real time: stack or seed_bench."),
]


@app.command(epilog="Example: piezod commission --emulated seed_bench -o seed")
def commission(
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="Folder for recordings, models and pages.")],
    config: OptionalConfig = None,
    emulated: EmulatedOption = None,
    frequency: Annotated[float, typer.Option(metavar="HZ", min=1e-4, help="Frequency of a triangle.")] = 0.1,
    periods: Annotated[int, typer.Option(min=5, max=1000, help="Triangles per excitation.")] = 20,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Record every excitation, identify a model from each and validate them side by side."""
    from contextlib import ExitStack, redirect_stdout

    from piezod.commissioning.emulator import virtual_time_bench
    from piezod.excitation import EXCITATIONS, IDENTIFICATION
    from piezod.recording.targets import check_folder

    if (config is None) == (emulated is None):
        raise UsageError("give CONFIG or --emulated SCENARIO, exactly one of them")
    check_folder(output, [f"{name}.{suffix}" for name in EXCITATIONS for suffix in ("csv", "yaml")], force=force)
    output.mkdir(parents=True, exist_ok=True)
    from piezod.report.identification import identification_text

    with ExitStack() as stack:
        bench = config or stack.enter_context(virtual_time_bench(output, str(emulated)))
        models = [output / f"{name}.yaml" for name in EXCITATIONS]
        with redirect_stdout(sys.stderr if as_json else sys.stdout):
            for name, model in zip(EXCITATIONS, models, strict=True):
                print(f"\n{name}", flush=True)
                repeats = 1 if name == IDENTIFICATION else periods
                recording = output / f"{name}.csv"
                record_to_file(bench, name, recording, None, frequency, repeats, force=force)
                result, _ = identify_files([recording], model, output / name, name=name, force=force)
                print(identification_text(result.identification))
                if not result.useful:
                    raise typer.Exit(1)
            print("\nvalidation", flush=True)
        page = output / "validation.html"
        raise typer.Exit(validate_models(bench, models, page, as_json=as_json, emulated=config is None))


@app.command(epilog="Example: piezod investigate config/bench.yaml --model model.yaml -o investigation")
def investigate(
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="Folder for recordings, drives and findings.")],
    model: Annotated[Path, typer.Option("--model", metavar="MODEL", help="Identified model.")],
    config: OptionalConfig = None,
    emulated: EmulatedOption = None,
    hidden: Annotated[
        list[str] | None, typer.Option(metavar="EFFECT", help="Effect of the emulated bench; repeatable.")
    ] = None,
    excitation: Annotated[
        str, typer.Option(metavar="NAME", help="First excitation, or a recording whose voltage is repeated.")
    ] = "staircase-minor-loops-multisine",
    drives: Annotated[int, typer.Option(min=1, max=20, help="Largest number of drives.")] = 4,
    longest: Annotated[float, typer.Option(metavar="S", min=6.0, max=600.0, help="Of a planned drive.")] = 60.0,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before a drive.")] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Record, diagnose and plan the next experiment, until no effect has a rival; then follow references."""
    from contextlib import ExitStack, redirect_stdout

    from piezod.commissioning.emulator import virtual_time_bench
    from piezod.model import load_model
    from piezod.recording.targets import check_folder

    if (config is None) == (emulated is None) or (hidden and not emulated):
        raise UsageError("give CONFIG, or --emulated SCENARIO with its --hidden effects, exactly one of them")
    if not yes and not sys.stdin.isatty():
        raise UsageError("--yes is missing: without a terminal nobody can be asked before a drive")
    check_folder(output, ("work_1.csv", "work.csv", "diagnosis_1"), force=force)
    load_model(model)  # a wrong file is refused before the libraries are there
    from piezod.commissioning.investigate import Drive, Step, step_text
    from piezod.commissioning.investigate import investigate as steps_of
    from piezod.report.diagnosis.page import write_diagnosis_page
    from piezod.report.next_step.of_benches import after_investigate
    from piezod.report.progress import steps

    def agreed(drive: Drive) -> bool:
        about = f"drive {drive.number}: {drive.excitation}, {drive.duration_s:.0f} s"
        print(f"\n{about}", flush=True)
        return yes or typer.confirm("drive the bench")

    output.mkdir(parents=True, exist_ok=True)
    done: list[Step] = []
    with ExitStack() as stack:
        bench = config or stack.enter_context(virtual_time_bench(output, str(emulated), hidden or ()))
        with redirect_stdout(sys.stderr if as_json else sys.stdout), steps() as show:
            for step in steps_of(
                bench,
                model,
                output,
                excitation=excitation,
                most_drives=drives,
                longest_s=longest,
                agreed=agreed,
                on_rows=lambda _: None,
                on_step=show,
            ):
                done.append(step)
                write_diagnosis_page(step.folder / "report.html", step.diagnosis)
                print(step_text(step))
        last = done[-1] if done else None
        extended = None if last is None else last.diagnosis.model
        changed = extended is not None and bool(extended.effects or extended.unnamed_law)
        following = None
        if last is not None:
            following = after_investigate(
                config, model, last.folder / "model.yaml", extended=changed, open_pairs=bool(last.open_pairs)
            )
        if as_json:
            content = {"schema": "piezod.investigate/1", "drives": [step.as_dict() for step in done]}
            more = {"next_step": None if following is None else following.as_dict()}
            print(json.dumps(content | more, indent=2))
        if last is None or following is None or as_json:
            return
        print(f"\npage: {(last.folder / 'report.html').resolve()}")
        if changed and (yes or typer.confirm("follow references with both models")):
            models = [model, last.folder / "model.yaml"]
            code = validate_models(bench, models, output / "validation.html", as_json=False, emulated=config is None)
            raise typer.Exit(code)
        print_next(following)
