"""`piezod run`, which is the daemon, and the commands for a running daemon."""

import json
from collections.abc import Coroutine
from pathlib import Path
from typing import Annotated

import typer

from piezod.cli.output import coloured, print_next, print_result
from piezod.cli.root import (
    ConfigArgument,
    DaemonArgument,
    ForceOption,
    JsonOption,
    SocketOption,
    WaitOption,
    app,
)
from piezod.errors import UsageError


@app.command(epilog="Example: piezod run config/bench.yaml --arm")
def run(
    config: ConfigArgument,
    arm: Annotated[
        bool, typer.Option("--arm", help="Arm at once and end with the reference; otherwise wait for piezod arm.")
    ] = False,
    sequence: Annotated[
        Path | None,
        typer.Option("--sequence", metavar="FILE", help="Test sequence to drive with --arm; without it only checked."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", metavar="DIR", help="With --sequence --arm: folder for junit.xml, page and recordings."),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run the bench in the foreground: one reference with --arm, otherwise until a signal (SIGTERM: ramp down)."""
    if sequence is not None:
        raise typer.Exit(_run_sequence(config, sequence, output, arm=arm, force=force, as_json=as_json))
    if output is not None:
        raise UsageError("-o is given without --sequence, whose results it is for")
    from piezod.daemon.run import run_foreground

    result = run_foreground(config, arm=arm)
    if as_json or arm:
        from piezod.config import load_bench
        from piezod.report.next_step.of_benches import after_run

        drifted = bool(result.drift and result.drift["drifted"])
        step = after_run(config, load_bench(config).recordings_path, fault=result.outcome.fault, drifted=drifted)
        if as_json:
            print(json.dumps(result.as_dict() | {"next_step": step.as_dict()}, indent=2))
        else:
            print_next(step)
    raise typer.Exit(result.exit_code)


def _run_sequence(config: Path, path: Path, output: Path | None, *, arm: bool, force: bool, as_json: bool) -> int:
    """Check a sequence; with `arm` drive it and write its results. Return the exit code."""
    from piezod.recording.targets import check_folder

    if arm and output is None:
        raise UsageError("-o is missing: --sequence with --arm needs a folder for its results")
    from piezod.commissioning.sequence import RESULTS, plan_sequence, remove_results, run_sequence

    check_folder(output, RESULTS, force=force)
    if arm and output is not None and force:
        remove_results(output)
    from piezod.config import model_path
    from piezod.daemon.run import rows_are_saved
    from piezod.recording import write_recording
    from piezod.report.next_step.of_benches import after_sequence
    from piezod.report.progress import progress

    plan = plan_sequence(config, path)
    model = model_path(plan.bench, config)
    if not arm or output is None:
        step = after_sequence(config, path, model, passed=None, fault="")
        about = {"name": plan.sequence.name, "steps": len(plan.ticks), "duration_s": plan.duration_s}
        content = {"schema": "piezod.sequence_check/1", **about}
        lines = [
            coloured(f"{check.level:4}  {check.name}: {check.found} -> {check.remedy}")
            for check in plan.checks
            if check.level == "WARN"
        ]
        lines.append(f"{path}: {len(plan.ticks)} steps, about {plan.duration_s:.0f} s; not driven, --arm is not given")
        print_result(content, "\n".join(lines), step, as_json=as_json)
        return 0
    from piezod.report.tracking.sequence import evaluate_sequence, junit_xml, sequence_text, write_sequence_page
    from piezod.runtime.files import written
    from piezod.session.task import Outcome

    killed = evaluate_sequence(plan.sequence, [], Outcome(fault="the run did not come to its end"))
    written(output / RESULTS[0], junit_xml(killed), parents=True)  # before anything is driven
    with progress(f"{len(plan.ticks)} steps", plan.duration_s) as show:
        result = run_sequence(plan, config, show)
    verdict = evaluate_sequence(plan.sequence, result.runs, result.outcome)
    step = after_sequence(config, path, model, passed=verdict.passed, fault=result.outcome.fault)
    for number, run in enumerate(result.runs, 1):
        if run.recording.time_s.size:
            write_recording(run.recording, output / f"step_{number}.csv")
    rows_are_saved()
    junit, page = (output / name for name in RESULTS)
    written(junit, junit_xml(verdict))
    write_sequence_page(page, verdict, result.runs, step)
    text = f"{coloured(sequence_text(verdict))}\n{junit}, {page}"
    print_result(verdict.as_dict(), text, step, as_json=as_json)
    return 0 if verdict.passed else 1


@app.command(epilog="Example: piezod status config/bench.yaml --json")
def status(config: DaemonArgument = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Print the state of the running daemon."""
    from piezod.daemon.client import command_and_wait, find_socket
    from piezod.daemon.status import status_text
    from piezod.report.next_step.of_benches import after_status

    answer = command_and_wait(find_socket(config, socket), "status", wait=False)
    print_result(answer, coloured(status_text(answer)), after_status(answer), as_json=as_json)


@app.command(epilog="Example: piezod arm config/bench.yaml")
def arm(
    config: DaemonArgument = None, socket: SocketOption = None, wait: WaitOption = True, as_json: JsonOption = False
) -> None:
    """Check every precondition and the sign, drive to the first reference value and follow the reference."""
    _command_daemon("arm", config, socket, ("RUNNING", "HOLD"), wait=wait, as_json=as_json)


@app.command(epilog="Example: piezod disarm config/bench.yaml")
def disarm(
    config: DaemonArgument = None, socket: SocketOption = None, wait: WaitOption = True, as_json: JsonOption = False
) -> None:
    """Ramp down and disarm."""
    _command_daemon("disarm", config, socket, ("DISARMED",), wait=wait, as_json=as_json)


@app.command(epilog="Example: piezod stop config/bench.yaml")
def stop(
    config: DaemonArgument = None,
    socket: SocketOption = None,
    direct: Annotated[
        bool, typer.Option("--direct", help="Without the daemon: connect to the device of CONFIG directly.")
    ] = False,
    wait: WaitOption = True,
    as_json: JsonOption = False,
) -> None:
    """Ramp down as fast as the slew limit allows, and disarm."""
    if not direct:
        _command_daemon("stop", config, socket, ("DISARMED",), wait=wait, as_json=as_json)
        return
    if config is None or socket is not None:
        raise UsageError("--direct needs CONFIG, which names the device, and no --socket")
    from piezod.commissioning.safe_stop import stop_directly

    message = stop_directly(config)
    print(json.dumps({"ok": True, "message": message}, indent=2) if as_json else message)


@app.command(epilog="Example: piezod reset config/bench.yaml")
def reset(config: DaemonArgument = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Leave the state FAULT after its cause is gone; the bench stays disarmed."""
    _command_daemon("reset", config, socket, (), wait=False, as_json=as_json)


@app.command(epilog="Example: piezod reload config/bench.yaml")
def reload(config: DaemonArgument = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Make the daemon read its configuration again, as SIGHUP does; while armed it accepts only tighter limits."""
    _command_daemon("reload", config, socket, (), wait=False, as_json=as_json)


def _command_daemon(
    name: str, config: Path | None, socket: Path | None, wanted: tuple[str, ...], *, wait: bool, as_json: bool
) -> None:
    """Send a command, wait for the result and print it; exit code 1 if the state is not in `wanted`."""
    from piezod.daemon.client import command_and_wait, find_socket
    from piezod.daemon.status import status_text

    answer = command_and_wait(find_socket(config, socket), name, wait=wait)
    complete = "state" in answer
    if as_json:
        print(json.dumps(answer, indent=2))
    else:
        print(coloured(status_text(answer) if complete else answer["message"]))
    raise typer.Exit(1 if complete and answer["state"] not in wanted else 0)


@app.command(epilog="Example: piezod bridge config/bench.yaml --mqtt mqtt://broker")
def bridge(
    config: ConfigArgument,
    mqtt: Annotated[
        str | None, typer.Option(metavar="URL", help="Broker: mqtt://[USER:PASSWORD@]HOST[:PORT], mqtts:// for TLS.")
    ] = None,
    opcua: Annotated[
        int | None, typer.Option(metavar="PORT", min=1, max=65535, help="Port of an OPC UA server on 127.0.0.1.")
    ] = None,
    certificates: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="server.der, server.pem, clients/*.der: OPC UA is encrypted, with arm, disarm and stop."
        ),
    ] = None,
) -> None:
    """Carry the values of the running daemon to MQTT and OPC UA; it reads shared memory and cannot delay a tick."""
    from piezod.bridge.mqtt import Broker, publish
    from piezod.bridge.opcua import serve
    from piezod.bridge.run import run_bridges
    from piezod.config import load_bench
    from piezod.daemon.client import command_and_wait

    if mqtt is None and opcua is None:
        raise UsageError("--mqtt or --opcua is missing: give one of them, or both")
    if certificates is not None and opcua is None:
        raise UsageError("--certificates needs --opcua PORT")
    bench, broker = load_bench(config), None if mqtt is None else Broker.of(mqtt)

    def send(name: str) -> dict[str, object]:
        return command_and_wait(bench.socket_path, name, wait=False)

    def announce(line: str) -> None:
        print(line, flush=True)

    def bridges() -> list[Coroutine[object, object, None]]:
        made = [] if broker is None else [publish(bench, broker, send, announce)]
        return made if opcua is None else [*made, serve(bench, opcua, certificates, send, announce)]

    run_bridges(bridges)


@app.command(epilog="Example: piezod watch config/bench.yaml --port 5006")
def watch(
    config: ConfigArgument,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on 127.0.0.1; 0: any free port.")] = 5006,
    token_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File with the token for arm, disarm, stop and reset; default: read only."),
    ] = None,
    host: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Further name that the page is opened under, as behind a proxy; repeatable."),
    ] = None,
) -> None:
    """Serve a live page of the running daemon; it reads shared memory and cannot delay a tick."""
    from piezod.config import load_bench

    bench = load_bench(config)  # a wrong file is refused before the libraries are there
    from piezod.daemon.client import command_and_wait
    from piezod.report.live.server import read_token, serve_live_page

    token = None if token_file is None else read_token(token_file)
    serve_live_page(
        bench,
        lambda name: command_and_wait(bench.socket_path, name, wait=False),
        port,
        token,
        lambda line: print(line, flush=True),
        host or (),
    )
