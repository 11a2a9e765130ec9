"""Commands around a bench file: create and check it, check bench and machine, pack a support bundle."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piezod.cli.output import coloured, print_next, print_result
from piezod.cli.root import ConfigArgument, JsonOption, app
from piezod.errors import UsageError

if TYPE_CHECKING:
    from piezod.report.next_step import NextStep


@app.command(epilog="Example: piezod check config/bench.yaml")
def check(
    config: ConfigArgument,
    proof: Annotated[
        bool, typer.Option("--proof", help="Drive the bench at low voltage through its trips, its watchdog and a stop.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("-o", metavar="FILE", help="With --proof: record to write; default: NAME-proof-DATE.")
    ] = None,
    tester: Annotated[str, typer.Option(metavar="NAME", help="With --proof: who tests; default: the user.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Check configuration, model, link, device, clock and rights; writes no voltage unless --proof is given."""
    if proof:
        _prove(config, output, tester, as_json)
        return
    if output is not None:
        raise UsageError("-o is given without --proof, which alone writes a record")
    if tester:
        raise UsageError("--tester is given without --proof, which alone writes a record")
    from piezod.commissioning.check import check_bench

    checks = check_bench(config)
    if as_json:
        print(json.dumps([result.__dict__ for result in checks], indent=2))
    else:
        for result in checks:
            remedy = f" -> {result.remedy}" if result.remedy else ""
            print(coloured(f"{result.level:4}  {result.name}: {result.found}{remedy}"))
        print_next(_after_check(config, [result.name for result in checks if result.level == "FAIL"]))
    raise typer.Exit(1 if any(result.level == "FAIL" for result in checks) else 0)


def _after_check(config: Path, failed: list[str]) -> "NextStep":
    """Next step after `piezod check`, with the names of the failed checks."""
    from piezod.config import load_bench, model_path
    from piezod.report.next_step.of_benches import after_check

    exists = "configuration" in failed or model_path(load_bench(config), config).exists()
    return after_check(config, failed, model_exists=exists)


def _prove(config: Path, output: Path | None, tester: str, as_json: bool) -> None:
    """Run the proof test, print its steps and end with 1 unless all have passed."""
    from piezod.commissioning.proof import prove
    from piezod.commissioning.proof.record import text_lines
    from piezod.report.next_step.of_benches import after_proof

    record, path = prove(config, output, tester)
    step = after_proof(config, passed=bool(record["passed"]))
    lines = [*text_lines(record), f"{path}: {'passed' if record['passed'] else 'NOT PASSED'}"]
    print_result(record, "\n".join(lines), step, as_json=as_json)
    raise typer.Exit(0 if record["passed"] else 1)


@app.command(epilog="Example: piezod init --profile labjack_t7 --host 192.168.1.207 --name press --yes")
def init(
    output: Annotated[Path, typer.Option("-o", metavar="FILE", help="Bench file to write.")] = Path("bench.yaml"),
    profile: Annotated[
        str | None, typer.Option(metavar="NAME", help="Device profile; default: asked for, or the profiles are listed.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the bench.")] = None,
    host: Annotated[str | None, typer.Option(help="Modbus TCP: address of the device.")] = None,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="Modbus TCP: port of the device.")] = None,
    unit_id: Annotated[int | None, typer.Option(min=0, max=255, help="Modbus TCP: unit of the device.")] = None,
    serial: Annotated[
        str | None, typer.Option(metavar="PORT", help="Serial: port, such as /dev/serial/by-id/...")
    ] = None,
    load_cell_host: Annotated[
        str | None, typer.Option(metavar="HOST", help="Modbus TCP: address of a separate device for the load cell.")
    ] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Ticks per second.")] = None,
    voltage_max: Annotated[float | None, typer.Option(metavar="V", help="Highest voltage of the stack.")] = None,
    force_trip: Annotated[float | None, typer.Option(metavar="N", help="Force above which the bench trips.")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing: the profile gives all other values.")] = False,
    probe: Annotated[bool, typer.Option(help="Check whether the device answers; only reads.")] = True,
    discover: Annotated[
        bool, typer.Option("--discover", help="Only list serial ports and the Modbus device at --host; only reads.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make a commented bench file from a device profile and a few answers."""
    from piezod.commissioning.init import Answers, draft_bench, list_profiles, probe_device, write_bench
    from piezod.commissioning.init import discover as discovered
    from piezod.commissioning.wizard import ask_missing

    if discover:
        from piezod.report.next_step.of_benches import after_discover

        found = discovered(host, port, unit_id)
        content: dict[str, object] = {"schema": "piezod.discover/1", "found": found}
        print_result(content, "\n".join(found), after_discover(host, port), as_json=as_json)
        return
    if output.exists() and not force:
        raise UsageError(f"{output} already exists; name another file with -o, or replace it with --force")
    answers = Answers(name, host, port, unit_id, serial, load_cell_host, rate, voltage_max, force_trip)
    if not yes and sys.stdin.isatty():
        profile, answers = ask_missing(profile, answers)
    if profile is None:
        raise UsageError(f"--profile is missing, one of {', '.join(list_profiles())}")
    made = draft_bench(profile, answers, output)
    identity = probe_device(made.bench) if probe else []
    write_bench(made, force=force)
    from piezod.report.next_step.of_benches import after_init

    content = {"schema": "piezod.init/1", "file": str(output), "profile": profile, "found": identity}
    lines = [*identity, f"{output}: bench '{made.bench.name}', from profile {profile}"]
    lines.append("its limits are placeholders: set each from the data sheet of the stack, amplifier or load cell")
    print_result(content, "\n".join(lines), after_init(output), as_json=as_json)


configuration = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="A bench file: its schema, its effective values, a check."
)
app.add_typer(configuration, name="config")


@configuration.command("schema", epilog="Example: piezod config schema > bench.schema.json")
def config_schema() -> None:
    """Print the JSON schema of a bench file, for completion in an editor."""
    from piezod.commissioning.shipped_files import shipped
    from piezod.config.file_text import comments_of
    from piezod.config.keys import bench_schema

    comments = comments_of(shipped("bench.yaml").read_text(encoding="utf-8"))
    print(json.dumps(bench_schema(comments), indent=2))


@configuration.command("show", epilog="Example: piezod config show config/bench.yaml")
def config_show(config: ConfigArgument, as_json: JsonOption = False) -> None:
    """Print every key with its value, its unit and whether it is a default, as valid YAML."""
    from piezod.config import load_bench, read_document
    from piezod.config.keys import all_values, effective_text, entries

    values, content = all_values(load_bench(config)), read_document(config).content
    if not as_json:
        print(effective_text(values, content), end="")
        return
    defaults = [".".join(entry.path) for entry in entries(values, content) if entry.default]
    print(json.dumps({"schema": "piezod.config/1", "effective": values, "defaults": defaults}, indent=2))


@configuration.command("check", epilog="Example: piezod config check config/bench.yaml")
def config_check(config: ConfigArgument, as_json: JsonOption = False) -> None:
    """Validate a bench file, without access to a device."""
    from piezod.config import load_bench, model_path
    from piezod.report.next_step.of_benches import after_config_check

    bench = load_bench(config)
    model = model_path(bench, config)
    exists, acts = model.exists(), bench.limits.acts_after
    content = {"schema": "piezod.config_check/1", "file": str(config), "bench": bench.name, "model": str(model)}
    text = f"{config}: bench '{bench.name}', {bench.rate_Hz:g} Hz over {bench.link.kind}"
    text += "".join(f"\nlimits.{name}: {when}" for name, when in acts.items())
    if not exists:
        text += f"\nits model {model} does not exist yet: make it with piezod record, then piezod identify"
    step = after_config_check(config, model_exists=exists)
    print_result(content | {"model_there": exists, "acts_after": acts}, text, step, as_json=as_json)


@app.command("support-bundle", epilog="Example: piezod support-bundle config/bench.yaml -o support.zip")
def support_bundle(
    config: ConfigArgument,
    output: Annotated[Path, typer.Option("-o", metavar="FILE.zip", help="File to write.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Pack files for remote support: configuration without secrets, versions, machine, last ticks."""
    from piezod.commissioning.support_bundle import write_bundle

    about = write_bundle(config, output, force=force)
    if as_json:
        print(json.dumps(about | {"file": str(output)}, indent=2))
        return
    print(f"{output}: check it before you send it; names, addresses and lines are replaced, numbers are not")
    for name, why in about["left_out"].items():
        print(f"without {name}: {why}")


@app.command(epilog="Example: piezod latency --seconds 5")
def latency(
    seconds: Annotated[float, typer.Option(min=0.1, max=600, help="Duration of the test at each rate [s].")] = 2.0,
    rate: Annotated[list[float] | None, typer.Option(metavar="HZ", help="Rate to test; repeatable.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how late this machine starts its ticks, and the highest rate that it holds."""
    from piezod.commissioning.slow_machine import limits_block, suggested_limits
    from piezod.config import RealTimeConfig
    from piezod.control.latency import RATES_HZ, measure_lateness, rate_held_Hz
    from piezod.report.next_step.of_benches import after_latency
    from piezod.session.history import percentiles

    measured = [measure_lateness(rate_Hz, seconds, RealTimeConfig()) for rate_Hz in rate or RATES_HZ]
    rows: list[dict[str, Any]] = [
        {"rate_Hz": result.rate_Hz, "missed": result.missed, "lateness_us": percentiles(result.lateness_us)}
        for result in measured
    ]
    held, limits = rate_held_Hz(measured), suggested_limits(measured)
    step = after_latency(limits_block(limits).splitlines(), held=held is not None)
    lines = ["  rate [Hz]   missed   lateness [us] p50      p99    p99.9      max"]
    for row in rows:
        late = row["lateness_us"]
        others = "".join(f"{late[k]:9.1f}" for k in ("p99", "p99.9", "max"))
        lines.append(f"{row['rate_Hz']:11g} {row['missed']:8d} {late['p50']:19.1f}{others}")
    lines.append(f"holds {held:g} Hz" if held else "holds none of these rates: see the warnings, or end other programs")
    content = {"rates": rows, "rate_held_Hz": held, "suggested": limits}
    print_result(content, "\n".join(lines), step, as_json=as_json)
