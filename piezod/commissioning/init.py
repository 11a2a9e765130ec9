"""`piezod init`: a commented bench file from a profile and a few answers; the device is looked at, never written to."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from piezod.commissioning.shipped_files import shipped
from piezod.config import BenchConfig, Document, bench_of, read_document, replace_values
from piezod.config.bench import SCHEMA
from piezod.config.link import ModbusTcpLink
from piezod.errors import ConfigurationError, PiezodError, UsageError
from piezod.session.assembly import opened_link
from piezod.transport.probe import modbus_name

EMULATOR = "bench"


@dataclass(frozen=True)
class Answers:
    """What the wizard wants to know; None: as the profile has it.

    Parameters
    ----------
    name
        Of the bench.
    host, port, unit_id
        Of a Modbus TCP device.
    serial
        Port of a serial device.
    load_cell_host
        Address of the device that reads the load cell, where that is another one.
    rate_Hz
        Ticks per second.
    voltage_max_V, force_trip_N
        Limits.
    """

    name: str | None = None
    host: str | None = None
    port: int | None = None
    unit_id: int | None = None
    serial: str | None = None
    load_cell_host: str | None = None
    rate_Hz: float | None = None
    voltage_max_V: float | None = None
    force_trip_N: float | None = None


@dataclass(frozen=True)
class Draft:
    """A bench file that could be written."""

    path: Path
    text: str
    bench: BenchConfig


def profiles() -> dict[str, str]:
    """Shipped bench files by name: what each is for, from its first line."""
    found = {}
    for path in sorted(shipped("bench.yaml").parent.glob("*.yaml")):
        if read_document(path).content.get("schema") == SCHEMA:
            first = path.read_text(encoding="utf-8").partition("\n")[0]
            found[path.stem] = first.lstrip("# ").partition(":")[0].partition(",")[0].rstrip(".")
    return found


def draft(profile: str, answers: Answers, path: Path) -> Draft:
    """Write the answers into a profile, comments and all, and check the outcome.

    Raises
    ------
    UsageError
        There is no such profile, or an answer does not belong to its link.
    ConfigurationError
        The answers make no bench.
    """
    known = profiles()
    if profile not in known:
        raise UsageError(f"--profile is '{profile}', must be one of {', '.join(known)}")
    text = shipped(f"{profile}.yaml").read_text(encoding="utf-8")
    before = bench_of(Document(path, text))
    text = replace_values(path, text, _changes(before, answers))
    return Draft(path, text, bench_of(Document(path, text)))


def _changes(bench: BenchConfig, answers: Answers) -> Mapping[tuple[str, ...], str | float | int]:
    """Answers by the path of the key that they go to."""
    modbus_tcp = isinstance(bench.link, ModbusTcpLink)
    places: tuple[tuple[str, tuple[str, ...], bool], ...] = (
        ("name", ("name",), True),
        ("rate_Hz", ("rate_Hz",), True),
        ("host", ("link", "host"), modbus_tcp),
        ("port", ("link", "port"), modbus_tcp),
        ("unit_id", ("link", "unit_id"), modbus_tcp),
        ("serial", ("link", "port"), not modbus_tcp),
        ("load_cell_host", ("load_cell_link", "host"), isinstance(bench.load_cell_link, ModbusTcpLink)),
        ("voltage_max_V", ("limits", "voltage_max_V"), True),
        ("force_trip_N", ("limits", "force_trip_N"), True),
    )
    changes: dict[tuple[str, ...], str | float | int] = {}
    for answer, path, fits in places:
        value = getattr(answers, answer)
        if value is None:
            continue
        if not fits:
            option = "--" + answer.replace("_", "-")
            raise UsageError(f"{option} does not belong to this profile, whose link is {bench.link.kind}; leave it out")
        changes[path] = value
    return changes


def look(bench: BenchConfig) -> list[str]:
    """What answers there, a line each; reads only.

    Parameters
    ----------
    bench
        As drafted.
    """
    lines = []
    link = bench.link
    if isinstance(link, ModbusTcpLink) and link.tls is None:
        name = modbus_name(link.host, link.port, link.unit_id)
        lines.append(f"{link.host}:{link.port}: {name or 'nobody answers; is it switched on, is the address right?'}")
        if not name:
            return lines
    try:
        with opened_link(bench):
            lines.append("identity, map version and byte order: as the profile expects, as far as it names them")
    except PiezodError as error:
        lines.append(f"not as the profile expects: {error}")
    return lines


def write(made: Draft, *, force: bool) -> None:
    """Write the file, whole or not at all.

    Raises
    ------
    UsageError
        It is there already.
    ConfigurationError
        It cannot be written.
    """
    path = made.path
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(made.text, encoding="utf-8")
        if force:
            temporary.replace(path)
        else:
            os.link(temporary, path)  # refuses a file that is there, also one that came a moment ago
    except FileExistsError:
        raise UsageError(f"{path} is there already; name another with -o, or replace it with --force") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        temporary.unlink(missing_ok=True)
