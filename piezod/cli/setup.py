"""A bench before it runs: its file, what is found of it, and what is sent to somebody who helps."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from piezod.cli.root import ConfigArgument, JsonOption, app
from piezod.errors import UsageError


@app.command(epilog="Example: piezod check config/bench.yaml")
def check(config: ConfigArgument, as_json: JsonOption = False) -> None:
    """Check configuration, model, link, device, clock and rights; never energises."""
    from piezod.commissioning.check import check_bench

    checks = check_bench(config)
    if as_json:
        print(json.dumps([one.__dict__ for one in checks], indent=2))
    else:
        for one in checks:
            print(f"{one.level:4}  {one.name}: {one.found}" + (f" -> {one.remedy}" if one.remedy else ""))
    raise typer.Exit(1 if any(one.level == "FAIL" for one in checks) else 0)


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
    from piezod.commissioning.init import Answers, draft, look, profiles, write
    from piezod.commissioning.wizard import ask

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
    from piezod.commissioning.shipped_files import shipped
    from piezod.config import bench_schema, comments_of

    comments = comments_of(shipped("bench.yaml").read_text(encoding="utf-8"))
    print(json.dumps(bench_schema(comments), indent=2))


@configuration.command("show", epilog="Example: piezod config show config/bench.yaml")
def config_show(config: ConfigArgument, as_json: JsonOption = False) -> None:
    """Print every key with its value, its unit, and whether it is a default; as YAML that can be read again."""
    from piezod.config import all_values, effective_text, entries, load_bench, read_document

    values, content = all_values(load_bench(config)), read_document(config).content
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


@app.command("support-bundle", epilog="Example: piezod support-bundle config/bench.yaml -o support.zip")
def support_bundle(
    config: ConfigArgument,
    output: Annotated[Path, typer.Option("-o", metavar="FILE.zip", help="The file to write.")],
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Pack what somebody elsewhere needs to help: configuration without secrets, versions, machine, last ticks."""
    from piezod.commissioning.support_bundle import write_bundle

    about = write_bundle(config, output, force=force)
    if as_json:
        print(json.dumps(about | {"file": str(output)}, indent=2))
        return
    print(f"{output}: look it over before it is sent; names, addresses and lines are replaced, numbers are not")
    for name, why in about["left_out"].items():
        print(f"without {name}: {why}")


@app.command(epilog="Example: piezod latency --seconds 5")
def latency(
    seconds: Annotated[float, typer.Option(min=0.1, max=600, help="How long each rate is kept.")] = 2.0,
    rate: Annotated[list[float] | None, typer.Option(metavar="HZ", help="Rates to try; repeatable.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how late this machine wakes up, and the highest rate it holds."""
    from piezod.config import RealTimeConfig
    from piezod.control.latency import RATES_HZ, measure_lateness, rate_held_Hz
    from piezod.session.history import percentiles

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
