"""`piezod commission`: excitations, models and their comparison in one command."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.models import identify, validate
from piezod.cli.recordings import record
from piezod.cli.root import JsonOption, app
from piezod.errors import UsageError


@app.command(epilog="Example: piezod commission --emulated seed_bench -o seed")
def commission(
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="Folder for recordings, models and pages.")],
    config: Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="Bench configuration.")] = None,
    emulated: Annotated[
        str | None,
        typer.Option(metavar="SCENARIO", help="Emulated bench that runs faster than real time: stack or seed_bench."),
    ] = None,
    frequency: Annotated[float, typer.Option(metavar="HZ", min=1e-4, help="Frequency of a triangle.")] = 0.1,
    periods: Annotated[int, typer.Option(min=5, max=1000, help="Triangles per excitation.")] = 20,
    as_json: JsonOption = False,
) -> None:
    """Record every excitation, identify a model from each and validate them side by side."""
    from contextlib import ExitStack, redirect_stdout

    from piezod.commissioning.emulator import virtual_time_bench
    from piezod.excitation import EXCITATIONS, IDENTIFICATION

    if (config is None) == (emulated is None):
        raise UsageError("give CONFIG or --emulated SCENARIO, exactly one of them")
    output.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        bench = config or stack.enter_context(virtual_time_bench(output, str(emulated)))
        models = [output / f"{name}.yaml" for name in EXCITATIONS]
        with redirect_stdout(sys.stderr if as_json else sys.stdout):
            for name, model in zip(EXCITATIONS, models, strict=True):
                print(f"\n{name}", flush=True)
                repeats = 1 if name == IDENTIFICATION else periods
                record(bench, name, output / f"{name}.csv", frequency=frequency, periods=repeats)
                identify([output / f"{name}.csv"], model, output / name, name=name)
            print("\nvalidation", flush=True)
        validate(bench, models, output / "validation.html", as_json=as_json)
