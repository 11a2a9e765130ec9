"""The commands: each parses, calls one function and prints what it returns."""

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piezod import __version__
from piezod.errors import PiezodError, UsageError

if TYPE_CHECKING:
    from piezod.recording import Recording
    from piezod.report.demo import HiddenVerdict

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Feedforward force control for piezo stacks. Commands that read print JSON with --json.",
)

ConfigArgument = Annotated[Path, typer.Argument(metavar="CONFIG", help="Bench configuration, e.g. config/bench.yaml.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
DaemonArgument = Annotated[
    Path | None, typer.Argument(metavar="[CONFIG]", help="Its bench configuration; left out: the only daemon here.")
]
SocketOption = Annotated[Path | None, typer.Option("--socket", metavar="PATH", help="Its socket, instead of CONFIG.")]
WaitOption = Annotated[bool, typer.Option(help="Wait for what comes of it.")]


_Misused = typer.BadParameter.__mro__[2]  # click's base of all that is wrong with arguments


def main() -> None:
    """Run a command; a deliberate error is one line on stderr and its exit code."""
    try:
        code = app(standalone_mode=False, prog_name="piezod")
        sys.exit(code if isinstance(code, int) else 0)
    except PiezodError as error:
        print(f"piezod: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    except Exception as error:
        if not isinstance(error, _Misused):
            raise
        print(_misuse_text(error), file=sys.stderr)
        sys.exit(UsageError.exit_code)


def _misuse_text(error: Exception) -> str:
    """What is wrong with the arguments, in one line; the help where nothing was given at all."""
    context, said = getattr(error, "ctx", None), getattr(error, "format_message", lambda: str(error))()
    if context is not None and said.startswith("Usage:"):
        return str(said)
    path = "piezod" if context is None else context.command_path
    return f"piezod: {' '.join(said.split()).rstrip('.')}; see {path} --help"


def _version(wanted: bool) -> None:
    if wanted:
        print(f"piezod {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[  # handled by its callback
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command(epilog="Example: piezod demo --report demo.html --json demo.json")
def demo(
    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the figures as JSON.")] = None,
    report: Annotated[Path, typer.Option(metavar="FILE", help="The page to write.")] = Path("piezod-demo.html"),
) -> None:
    """Show the whole path on the emulated bench: no hardware, no root, under a minute."""
    from piezod.daemon.demo import run_demo
    from piezod.report.demo import judge, live_line, print_hidden, print_table, write_demo_page

    names: list[str] = []
    print("emulated bench and control process are starting ...", flush=True)
    with live_line(names) as show:
        result = run_demo(show, names)
    verdict = judge(result.recordings, result.history.timing(), result.outcome)
    print_table(verdict)
    recordings = dict(result.recordings)
    if not result.outcome.stopped and not result.outcome.fault:
        hidden, followed = _demo_hidden()
        print_hidden(hidden)
        verdict = replace(verdict, hidden=hidden)
        recordings |= followed
    write_demo_page(report, verdict, recordings)
    print(f"page: {report.resolve()}")
    if json_file is not None:
        json_file.write_text(json.dumps(verdict.as_dict(), indent=2) + "\n", encoding="utf-8")
    raise typer.Exit(0 if verdict.passed else 1)


def _demo_hidden() -> "tuple[HiddenVerdict, dict[tuple[str, str], Recording]]":
    """Record a bench that hides something, diagnose it, follow a reference with what was known and what was found."""
    from tempfile import TemporaryDirectory

    from piezod.daemon.demo_hidden import follow_hidden, record_hidden
    from piezod.daemon.shipped import shipped
    from piezod.diagnose.command import diagnose_files
    from piezod.model import load_model
    from piezod.recording import write_csv
    from piezod.report.demo import judge_hidden
    from piezod.report.progress import steps

    with TemporaryDirectory() as name, steps() as show:
        folder, given = Path(name), shipped("model.yaml")
        show("a bench with hidden effects is recorded", 0.0)
        write_csv(record_hidden(folder, lambda _: None), folder / "work.csv")
        findings = diagnose_files([folder / "work.csv"], given, folder / "out", None, None, show).findings
        extended = load_model(folder / "out" / "model.yaml")
        show("a reference is followed with both models", 0.9)
        followed = follow_hidden(folder, load_model(given), extended, lambda _: None)
    return judge_hidden(followed, f"{findings.verdict}: {findings.words}", findings.floor), followed


@app.command(epilog="Example: piezod run config/bench.yaml --arm")
def run(
    config: ConfigArgument,
    arm: Annotated[
        bool, typer.Option("--arm", help="Arm at once, end with the reference; else wait for piezod arm.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run the bench in the foreground: with --arm one reference, else until a signal comes (SIGTERM: ramp down)."""
    from piezod.daemon.run import run_foreground

    result = run_foreground(config, arm=arm)
    if as_json:
        print(json.dumps(result.as_dict(), indent=2))
    raise typer.Exit(result.exit_code)


@app.command(epilog="Example: piezod status config/bench.yaml --json")
def status(config: DaemonArgument = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Say what the running daemon does."""
    from piezod.daemon.client import command_and_wait, socket_of, status_text

    answer = command_and_wait(socket_of(config, socket), "status", wait=False)
    print(json.dumps(answer, indent=2) if as_json else status_text(answer))


@app.command(epilog="Example: piezod arm config/bench.yaml")
def arm(
    config: DaemonArgument = None, socket: SocketOption = None, wait: WaitOption = True, as_json: JsonOption = False
) -> None:
    """Check every precondition, check the sign, drive to the first reference and follow it."""
    _command_daemon("arm", config, socket, ("RUNNING", "HOLD"), wait=wait, as_json=as_json)


@app.command(epilog="Example: piezod disarm config/bench.yaml")
def disarm(
    config: DaemonArgument = None, socket: SocketOption = None, wait: WaitOption = True, as_json: JsonOption = False
) -> None:
    """Ramp down and stay disarmed."""
    _command_daemon("disarm", config, socket, ("DISARMED",), wait=wait, as_json=as_json)


@app.command(epilog="Example: piezod stop config/bench.yaml")
def stop(
    config: DaemonArgument = None,
    socket: SocketOption = None,
    direct: Annotated[
        bool, typer.Option("--direct", help="Without a daemon: over a connection of its own to the device of CONFIG.")
    ] = False,
    wait: WaitOption = True,
    as_json: JsonOption = False,
) -> None:
    """Come to rest as fast as the slew limit allows, and stay disarmed."""
    if not direct:
        _command_daemon("stop", config, socket, ("DISARMED",), wait=wait, as_json=as_json)
        return
    if config is None or socket is not None:
        raise UsageError("--direct needs CONFIG, which names the device, and no --socket")
    from piezod.daemon.safe_stop import stop_directly

    message = stop_directly(config)
    print(json.dumps({"ok": True, "message": message}, indent=2) if as_json else message)


@app.command(epilog="Example: piezod reset config/bench.yaml")
def reset(config: DaemonArgument = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Leave FAULT, once its cause is gone; nothing is armed by it."""
    _command_daemon("reset", config, socket, (), wait=False, as_json=as_json)


@app.command(epilog="Example: piezod reload config/bench.yaml")
def reload(config: DaemonArgument = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Let the daemon read its configuration again, as SIGHUP does; while it is armed only tighter limits are taken."""
    _command_daemon("reload", config, socket, (), wait=False, as_json=as_json)


def _command_daemon(
    name: str, config: Path | None, socket: Path | None, wanted: tuple[str, ...], *, wait: bool, as_json: bool
) -> None:
    """Send a command, wait for what comes of it, print it; exit with 1 when that is not what was wanted."""
    from piezod.daemon.client import command_and_wait, socket_of, status_text

    answer = command_and_wait(socket_of(config, socket), name, wait=wait)
    settled = "state" in answer
    if as_json:
        print(json.dumps(answer, indent=2))
    else:
        print(status_text(answer) if settled else answer["message"])
    raise typer.Exit(1 if settled and answer["state"] not in wanted else 0)


@app.command(epilog="Example: piezod watch config/bench.yaml --port 5006")
def watch(
    config: ConfigArgument,
    port: Annotated[int, typer.Option(min=0, max=65535, help="On 127.0.0.1; 0 takes a free one.")] = 5006,
    token_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Whoever types what it holds may arm, disarm, stop, reset; else read only."),
    ] = None,
) -> None:
    """Serve a live page of the running daemon; it reads shared memory, and no tick knows of it."""
    from piezod.config import load_bench
    from piezod.daemon.client import command_and_wait
    from piezod.report.live.server import read_token, serve_live_page

    bench = load_bench(config)
    token = None if token_file is None else read_token(token_file)
    serve_live_page(
        bench,
        lambda name: command_and_wait(bench.socket_path, name, wait=False),
        port,
        token,
        lambda line: print(line, flush=True),
    )


@app.command(epilog="Example: piezod check config/bench.yaml")
def check(config: ConfigArgument, as_json: JsonOption = False) -> None:
    """Check configuration, model, link, device, clock and rights; never energises."""
    from piezod.daemon.check import check_bench

    checks = check_bench(config)
    if as_json:
        print(json.dumps([one.__dict__ for one in checks], indent=2))
    else:
        for one in checks:
            print(f"{one.level:4}  {one.name}: {one.found}" + (f" -> {one.remedy}" if one.remedy else ""))
    raise typer.Exit(1 if any(one.level == "FAIL" for one in checks) else 0)


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
    from piezod.daemon.record import excitation_s
    from piezod.daemon.record import record as record_excitation
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


@app.command(epilog="Example: piezod identify varying.csv constant.csv -o model.yaml --report report")
def identify(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="REC...", help="Recordings: csv, h5, mat, tdms, parquet, mf4.")
    ],
    model: Annotated[Path, typer.Option("-o", metavar="MODEL", help="The model file to write.")],
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="Write identification.html there.")] = None,
    input_column: Annotated[str, typer.Option("--input", metavar="COLUMN")] = "voltage_V",
    output_column: Annotated[str, typer.Option("--output", metavar="COLUMN")] = "force_N",
    plays: Annotated[int | None, typer.Option(min=1, max=100, help="n; judged on held-out data when left out.")] = None,
    dead_zones: Annotated[int | None, typer.Option(min=0, max=30, help="m; as above.")] = None,
    variant: Annotated[str, typer.Option(metavar="A|B", help="A: no weight negative; B: no partial sum.")] = "B",
    fit_share: Annotated[
        float, typer.Option(help="Leading share of each recording to fit; the rest is held out.")
    ] = 0.7,
    name: Annotated[str, typer.Option(help="Name of the model.")] = "stack",
    as_json: JsonOption = False,
) -> None:
    """Identify a model from recordings."""
    from piezod.identify.identification import Options
    from piezod.identify.identification import identify as identify_model
    from piezod.identify.intake import check_result, take_in
    from piezod.model import save_model
    from piezod.report.identification import figures_of, print_identification, write_identification_page
    from piezod.report.progress import steps

    if variant not in ("A", "B"):
        raise UsageError(f"--variant is '{variant}', must be A or B")
    check_result(model, recordings)
    options = Options(
        input=input_column,
        output=output_column,
        plays=plays,
        zones=dead_zones,
        variant="A" if variant == "A" else "B",
        fit_share=fit_share,
        name=name,
    )
    with steps() as show:
        taken = take_in(recordings, input_column, output_column, show)
        read = [one.recording for one in taken]
        identification = identify_model(
            read,
            options,
            f"piezod {__version__}",
            sources=[one.source for one in taken],
            notes=[note for one in taken for note in one.notes],
            on_step=show,
        )
    if report is not None:
        write_identification_page(report / "identification.html", identification, read)
    save_model(identification.model, model)
    if as_json:
        print(json.dumps(figures_of(identification), indent=2))
    else:
        print_identification(identification)


@app.command(epilog="Example: piezod simulate varying.csv --model model.yaml -o simulated.csv")
def simulate(
    recording: Annotated[Path, typer.Argument(metavar="REC", help="Whose input is simulated.")],
    model: Annotated[Path, typer.Option("--model", metavar="MODEL")],
    output: Annotated[Path, typer.Option("-o", metavar="OUT", help="time_s and the simulated output column.")],
    start_window: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="First seconds that may tell what the memory starts with.")
    ] = 1.0,
    condition: Annotated[
        str | None, typer.Option("--where", metavar="COLUMN=VALUE", help="Compare only the samples at which it holds.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate a model over a recording's input, in free run; compare with its output where it has one."""
    from piezod.identify.intake import check_result, take_whole
    from piezod.identify.simulation import simulate_recording, where
    from piezod.model import load_model
    from piezod.recording import check_target, write_recording
    from piezod.report.progress import steps

    check_target(output)
    check_result(output, [recording])
    loaded = load_model(model)
    column, equals, _ = (condition or "").partition("=")
    with steps() as show:
        taken = take_whole(recording, loaded.input.channel, loaded.output.channel, [column] if equals else [], show)
    chosen = where(taken.recording, condition) if condition else None
    simulation = simulate_recording(loaded, taken.recording, start_window, chosen, taken.sha256)
    write_recording(simulation.recording, output)
    figures = simulation.agreement
    if as_json:
        compared = None if figures is None else asdict(figures) | {"unit": loaded.output.unit}
        content = {"schema": "piezod.simulation/1", "start": simulation.start, "compared": compared}
        print(json.dumps(content | {"recording": taken.source.model_dump(), "notes": taken.notes}, indent=2))
    else:
        words = "" if figures is None else f"; {figures.words(loaded.output.unit)}"
        print(f"{output}: {taken.source.samples} samples; {simulation.start}{words}")
        for note in taken.notes:
            print(f"note: {note}")


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
    print(json.dumps(figures.as_dict(), indent=2) if as_json else f"{figures.words}\npage: {output.resolve()}")


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


@app.command(epilog="Example: piezod compare work.csv simulated.csv --model model.yaml --report comparison.html")
def compare(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="REC [REC...]", help="What was measured, then outputs to compare with it.")
    ],
    model: Annotated[
        list[Path] | None, typer.Option(metavar="MODEL", help="Simulated over the first recording's input; repeatable.")
    ] = None,
    output_column: Annotated[
        str | None, typer.Option("--output", metavar="COLUMN", help="The model's, or force_N, if left out.")
    ] = None,
    start_window: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="First seconds that may tell what a model's memory starts with.")
    ] = 1.0,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare a measured output with simulated ones and with models in free run: fit as MATLAB's compare defines it."""
    from piezod.report.compared import compare_files
    from piezod.report.comparison import comparison_as_dict, comparison_text, write_comparison_page

    comparison = compare_files(recordings[0], recordings[1:], model or (), output_column, start_window)
    if report is not None:
        write_comparison_page(report, comparison)
    print(json.dumps(comparison_as_dict(comparison), indent=2) if as_json else comparison_text(comparison))


@app.command(epilog="Example: piezod resid work.csv --model model.yaml --report residual.html")
def resid(
    recording: Annotated[Path, typer.Argument(metavar="REC", help="What was measured.")],
    model: Annotated[Path, typer.Option("--model", metavar="MODEL")],
    lags: Annotated[int, typer.Option(min=1, max=10_000, help="How many, in samples.")] = 25,
    start_window: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="First seconds that may tell what the memory starts with.")
    ] = 1.0,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Test whether what a model leaves is white and independent of the input, with the bounds of MATLAB's resid."""
    from piezod.identify.intake import take_whole
    from piezod.model import load_model
    from piezod.report.comparison import residual_as_dict, residual_text, write_residual_page
    from piezod.report.residual_test import residual_of, residual_test

    loaded = load_model(model)
    taken = take_whole(recording, loaded.input.channel, loaded.output.channel)
    left = residual_of(loaded, taken.recording, start_window, taken.sha256)
    test = residual_test(taken.recording, left, loaded.input.channel, lags)
    unit = loaded.output.unit
    if report is not None:
        write_residual_page(report, test, taken.recording, left, unit)
    if as_json:
        print(json.dumps(residual_as_dict(test, taken.recording, loaded.name, unit), indent=2))
    else:
        print(residual_text(test, unit))


@app.command(epilog="Example: piezod diagnose work.csv --model model.yaml -o diagnosis")
def diagnose(
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="findings.json, model.yaml and report.html.")],
    recordings: Annotated[list[Path] | None, typer.Argument(metavar="REC...", help="Recordings to explain.")] = None,
    model: Annotated[Path | None, typer.Option("--model", metavar="MODEL")] = None,
    from_bench: Annotated[
        Path | None,
        typer.Option(metavar="CONFIG", help="The stretch that the daemon kept when this bench left its model."),
    ] = None,
    input_column: Annotated[
        str | None, typer.Option("--input", metavar="COLUMN", help="The model's if left out.")
    ] = None,
    output_column: Annotated[str | None, typer.Option("--output", metavar="COLUMN", help="As above.")] = None,
    hold_out: Annotated[
        list[Path] | None,
        typer.Option(metavar="REC", help="Compare both models on it and fit nothing to it; repeatable."),
    ] = None,
    condition: Annotated[
        str | None, typer.Option("--where", metavar="COLUMN=VALUE", help="Only the readings at which it holds.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find out what a model leaves out of recordings: where, which physics, how sure, and the model that has it."""
    from piezod.diagnose.command import diagnose_files
    from piezod.report.diagnosis import print_findings
    from piezod.report.diagnosis_page import write_diagnosis_page
    from piezod.report.progress import steps

    recordings = list(recordings or ())
    if from_bench is not None:
        from piezod.daemon.drift import kept_stretch

        if recordings or model is not None:
            raise UsageError("--from-bench names recording and model: no REC and no --model beside it")
        kept, model = kept_stretch(from_bench)
        recordings = [kept]
    if model is None or not recordings:
        raise UsageError("REC... and --model are missing, or --from-bench CONFIG")
    with steps() as show:
        diagnosis = diagnose_files(
            recordings, model, output, input_column, output_column, show, hold_out or (), condition
        )
        show("drawing the report", None)
        write_diagnosis_page(output / "report.html", diagnosis)
    if as_json:
        print(json.dumps(diagnosis.findings.as_dict(), indent=2))
    else:
        print_findings(diagnosis, output)
        if from_bench is not None:
            print(f"to drive with it: model: {(output / 'model.yaml').resolve()} in {from_bench}, then piezod disarm")
            print("and piezod reload; nothing takes it by itself")


@app.command(epilog="Example: piezod validate config/bench.yaml --model a.yaml --model b.yaml --report validation.html")
def validate(
    config: ConfigArgument,
    model: Annotated[
        list[Path], typer.Option(metavar="MODEL", help="Model to try; repeatable. The first gives the plain gain too.")
    ],
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page with all loops.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Follow six triangular force references without and with each model; say which model is better."""
    from piezod.daemon.validate import plan_validation, run_validation
    from piezod.report.progress import progress
    from piezod.report.validation import judge_validation, validation_text, write_validation_page

    plan = plan_validation(config, model)
    with progress(f"{len(plan.works)} runs", plan.duration_s) as show:
        result = run_validation(plan, show)
    verdict = judge_validation(plan.references, plan.compensations, plan.range_N, result.recordings, result.outcome)
    print(json.dumps(verdict.as_dict(), indent=2) if as_json else validation_text(verdict))
    if report is not None:
        write_validation_page(report, verdict, result.recordings)
        if not as_json:
            print(f"page: {report.resolve()}")
    raise typer.Exit(0 if verdict.complete else 1)


@app.command(epilog="Example: piezod commission --emulated seed_bench -o seed")
def commission(
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="Recordings, models and pages are written there.")],
    config: Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="Bench configuration.")] = None,
    emulated: Annotated[
        str | None, typer.Option(metavar="SCENARIO", help="An emulated bench in its own time: stack or seed_bench.")
    ] = None,
    frequency: Annotated[float, typer.Option(metavar="HZ", min=1e-4, help="Of one full triangle.")] = 0.1,
    periods: Annotated[int, typer.Option(min=5, max=1000, help="Triangles of each excitation.")] = 20,
    as_json: JsonOption = False,
) -> None:
    """Record every excitation, identify a model from each and validate them side by side."""
    from contextlib import ExitStack, redirect_stdout

    from piezod.daemon.emulator import emulated_bench_file
    from piezod.excitation import EXCITATIONS, IDENTIFICATION

    if (config is None) == (emulated is None):
        raise UsageError("give CONFIG or --emulated SCENARIO, one of them")
    output.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        bench = config or stack.enter_context(emulated_bench_file(output, str(emulated)))
        models = [output / f"{name}.yaml" for name in EXCITATIONS]
        with redirect_stdout(sys.stderr if as_json else sys.stdout):
            for name, model in zip(EXCITATIONS, models, strict=True):
                print(f"\n{name}", flush=True)
                repeats = 1 if name == IDENTIFICATION else periods
                record(bench, name, output / f"{name}.csv", frequency=frequency, periods=repeats)
                identify([output / f"{name}.csv"], model, output / name, name=name)
            print("\nvalidation", flush=True)
        validate(bench, models, output / "validation.html", as_json=as_json)


@app.command(epilog="Example: piezod effects creep")
def effects(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="One effect in full.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the physical effects that can be found in a recording, or describe one."""
    from piezod.effects import EFFECTS
    from piezod.report.effects import effect_as_dict, effect_named, effect_page, effects_table

    chosen = None if name is None else effect_named(name)
    if as_json:
        shown = list(EFFECTS.values()) if chosen is None else [chosen]
        print(json.dumps({"schema": "piezod.effects/1", "effects": [effect_as_dict(one) for one in shown]}, indent=2))
    else:
        print(effects_table() if chosen is None else effect_page(chosen))


@app.command("support-bundle", epilog="Example: piezod support-bundle config/bench.yaml -o support.zip")
def support_bundle(
    config: ConfigArgument,
    output: Annotated[Path, typer.Option("-o", metavar="FILE.zip", help="The file to write.")],
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Pack what somebody elsewhere needs to help: configuration without secrets, versions, machine, last ticks."""
    from piezod.daemon.support import write_bundle

    about = write_bundle(config, output, force=force)
    if as_json:
        print(json.dumps(about | {"file": str(output)}, indent=2))
        return
    print(f"{output}: look it over before it is sent; names, addresses and lines are replaced, numbers are not")
    for name, why in about["left_out"].items():
        print(f"without {name}: {why}")


@app.command(epilog="Example: piezod init --profile labjack_t7 --host 192.168.1.207 --name press --yes")
def init(
    output: Annotated[Path, typer.Option("-o", metavar="FILE", help="The bench file to write.")] = Path("bench.yaml"),
    profile: Annotated[
        str | None, typer.Option(metavar="NAME", help="Device it starts from; asked for, or listed, when left out.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Of the bench.")] = None,
    host: Annotated[str | None, typer.Option(help="Modbus TCP: address of the device.")] = None,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="Modbus TCP: its port.")] = None,
    unit_id: Annotated[int | None, typer.Option(min=0, max=255, help="Modbus TCP: its unit.")] = None,
    serial: Annotated[str | None, typer.Option(metavar="PORT", help="Serial: such as /dev/serial/by-id/...")] = None,
    load_cell_host: Annotated[
        str | None, typer.Option(metavar="HOST", help="Of the device that reads the load cell, if that is another one.")
    ] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Ticks per second.")] = None,
    voltage_max: Annotated[float | None, typer.Option(metavar="V", help="Highest voltage of the stack.")] = None,
    force_trip: Annotated[float | None, typer.Option(metavar="N", help="Force above which it trips.")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing; else the profile's values are kept.")] = False,
    probe: Annotated[bool, typer.Option(help="Look whether the device answers; reads only.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make a commented bench file from a device profile and a few answers."""
    from piezod.daemon.init import Answers, draft, look, profiles, write
    from piezod.daemon.wizard import ask

    if output.exists() and not force:
        raise UsageError(f"{output} is there already; name another with -o, or replace it with --force")
    answers = Answers(name, host, port, unit_id, serial, load_cell_host, rate, voltage_max, force_trip)
    if not yes and sys.stdin.isatty():
        profile, answers = ask(profile, answers)
    if profile is None:
        raise UsageError(f"--profile is missing, one of {', '.join(profiles())}")
    made = draft(profile, answers, output)
    found = look(made.bench) if probe else []
    write(made, force=force)
    if as_json:
        said = {"schema": "piezod.init/1", "file": str(output), "profile": profile, "found": found}
        print(json.dumps(said, indent=2))
        return
    for line in found:
        print(line)
    print(f"{output}: bench '{made.bench.name}', from profile {profile}")
    print("its limits are placeholders until every one is set from the data sheets of stack, amplifier and load cell")
    print(f"then: piezod config check {output}, piezod check {output}")


configuration = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="A bench file: its schema, what it comes to, whether it is one."
)
app.add_typer(configuration, name="config")


@configuration.command("schema", epilog="Example: piezod config schema > bench.schema.json")
def config_schema() -> None:
    """Print the JSON schema of a bench file, for completion in an editor."""
    from piezod.config import bench_schema, comments_of
    from piezod.daemon.shipped import shipped

    comments = comments_of(shipped("bench.yaml").read_text(encoding="utf-8"))
    print(json.dumps(bench_schema(comments), indent=2))


@configuration.command("show", epilog="Example: piezod config show config/bench.yaml")
def config_show(config: ConfigArgument, as_json: JsonOption = False) -> None:
    """Print every key with its value, its unit, and whether it is a default; as YAML that can be read again."""
    from piezod.config import dumped, effective_text, entries, load_bench, read_document

    values, content = dumped(load_bench(config)), read_document(config).content
    if not as_json:
        print(effective_text(values, content), end="")
        return
    defaults = [".".join(one.path) for one in entries(values, content) if one.default]
    print(json.dumps({"schema": "piezod.config/1", "effective": values, "defaults": defaults}, indent=2))


@configuration.command("check", epilog="Example: piezod config check config/bench.yaml")
def config_check(config: ConfigArgument, as_json: JsonOption = False) -> None:
    """Validate a bench file; no device is asked."""
    from piezod.config import load_bench, model_path

    bench = load_bench(config)
    model = model_path(bench, config)
    if as_json:
        said = {"schema": "piezod.config_check/1", "file": str(config), "bench": bench.name, "model": str(model)}
        print(json.dumps(said | {"model_there": model.exists()}, indent=2))
        return
    print(f"{config}: bench '{bench.name}', {bench.rate_Hz:g} Hz over {bench.link.kind}")
    if not model.exists():
        print(f"its model {model} is not there yet: piezod record, then piezod identify")


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
    from piezod.blind.here import cores
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
    with steps(patience_s=0.0) as show:

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


@app.command(epilog="Example: piezod latency --seconds 5")
def latency(
    seconds: Annotated[float, typer.Option(min=0.1, max=600, help="How long each rate is kept.")] = 2.0,
    rate: Annotated[list[float] | None, typer.Option(metavar="HZ", help="Rates to try; repeatable.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how late this machine wakes up, and the highest rate it holds."""
    from piezod.config import RealTimeConfig
    from piezod.control.latency import RATES_HZ, measure_lateness, rate_held_Hz
    from piezod.daemon.history import percentiles

    measured = [measure_lateness(rate_Hz, seconds, RealTimeConfig()) for rate_Hz in rate or RATES_HZ]
    rows: list[dict[str, Any]] = [
        {"rate_Hz": one.rate_Hz, "missed": one.missed, "lateness_us": percentiles(one.lateness_us)} for one in measured
    ]
    held = rate_held_Hz(measured)
    if as_json:
        print(json.dumps({"rates": rows, "rate_held_Hz": held}, indent=2))
        return
    print("  rate [Hz]   missed   lateness [us] p50      p99    p99.9      max")
    for line in rows:
        late = line["lateness_us"]
        print(
            f"{line['rate_Hz']:11g} {line['missed']:8d} {late['p50']:19.1f}"
            + "".join(f"{late[k]:9.1f}" for k in ("p99", "p99.9", "max"))
        )
    print(f"holds {held:g} Hz" if held else "holds none of these rates: see the warnings, or free the machine")
