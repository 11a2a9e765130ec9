"""`piezod demo`: excitation, identification, control and diagnosis on the emulated bench."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezod.cli.output import print_next
from piezod.cli.root import app
from piezod.runtime.files import written

if TYPE_CHECKING:
    from piezod.recording import Recording
    from piezod.report.tracking.hidden import HiddenVerdict


@app.command(epilog="Example: piezod demo --report demo.html --json demo.json")
def demo(
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="File for the figures as JSON.")
    ] = None,
    report: Annotated[Path, typer.Option(metavar="FILE", help="Page to write.")] = Path("piezod-demo.html"),
    quick: Annotated[bool, typer.Option("--quick", help="One reference, without the hidden effects; 15 s.")] = False,
) -> None:
    """Run all steps on the emulated bench, without hardware or root rights, in about 75 s."""
    from piezod.commissioning.demo import run_demo
    from piezod.report.next_step.of_benches import after_demo
    from piezod.report.tracking.demo import evaluate_demo, live_line, print_demo, write_demo_page
    from piezod.report.tracking.hidden import print_hidden

    names: list[str] = []
    print("starting the emulated bench and the control process ...", flush=True)
    with live_line(names) as show:
        result = run_demo(show, names, quick=quick)
    verdict = evaluate_demo(result.recordings, result.history.timing(), result.outcome)
    print_demo(verdict)
    recordings = dict(result.recordings)
    if not (quick or result.outcome.stopped or result.outcome.fault):
        hidden, followed = _demo_hidden()
        print_hidden(hidden)
        verdict = replace(verdict, hidden=hidden)
        recordings |= followed
    write_demo_page(report, verdict, recordings)
    print(f"page: {report.resolve()}")
    step = after_demo(passed=verdict.passed)
    print_next(step)
    if json_file is not None:
        content = json.dumps(verdict.as_dict() | {"next_step": step.as_dict()}, indent=2)
        written(json_file, f"{content}\n")
    raise typer.Exit(0 if verdict.passed else 1)


def _demo_hidden() -> "tuple[HiddenVerdict, dict[tuple[str, str], Recording]]":
    """Record and diagnose a bench with hidden effects; follow a reference with the given and the extended model."""
    from tempfile import TemporaryDirectory

    from piezod.commissioning.demo_hidden_effects import compare_models, record_hidden_effects
    from piezod.commissioning.shipped_files import shipped
    from piezod.diagnose.command import diagnose_files
    from piezod.model import load_model
    from piezod.recording import write_csv
    from piezod.report.progress import steps
    from piezod.report.tracking.hidden import evaluate_hidden

    with TemporaryDirectory() as name, steps() as show:
        folder, given = Path(name), shipped("model.yaml")
        show("recording a bench with hidden effects", 0.0)
        write_csv(record_hidden_effects(folder, lambda _: None), folder / "work.csv")
        findings = diagnose_files([folder / "work.csv"], given, folder / "out", None, None, show).findings
        extended = load_model(folder / "out" / "model.yaml")
        show("following a reference with both models", 0.9)
        followed = compare_models(folder, load_model(given), extended, lambda _: None)
    sure = {effect.title: effect.confidence for effect in findings.effects}
    return evaluate_hidden(followed, f"{findings.verdict}: {findings.words}", findings.floor, sure), followed
