"""`piezod init`: make a commented bench configuration from a device profile and a few answers.

The device may be read, and is never written to.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from piezod.commissioning.shipped_files import shipped
from piezod.config import BenchConfig, read_document
from piezod.config.bench import SCHEMA, bench_of
from piezod.config.file_text import replace_values
from piezod.config.link import PLAIN_PORT, ModbusRtuLink, ModbusTcpLink, RtuOverTcpLink, SerialLineLink
from piezod.config.yaml_reader import Document
from piezod.errors import PiezodError, UsageError
from piezod.runtime.files import written
from piezod.session.assembly import opened_link
from piezod.transport.probe import SILENT, modbus_name, rtu_name, serial_ports


@dataclass(frozen=True)
class Answers:
    """Values in place of the profile's values; None keeps a value.

    Parameters
    ----------
    name
        Name of the bench.
    host, port, unit_id
        Address, TCP port and unit of a Modbus TCP device.
    serial
        Serial port of a serial device.
    load_cell_host
        Address of a separate device that reads the load cell.
    rate_Hz
        Tick rate [Hz].
    voltage_max_V
        Highest voltage of the stack [V].
    force_trip_N
        Force above which the bench trips [N].
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
class BenchDraft:
    """A bench configuration that is not written yet.

    Parameters
    ----------
    bench
        Configuration that the text contains.
    """

    path: Path
    text: str
    bench: BenchConfig


def list_profiles() -> dict[str, str]:
    """List the shipped bench configurations: name, and device from the first line of the file."""
    profiles = {}
    for path in sorted(shipped("bench.yaml").parent.glob("*.yaml")):
        if read_document(path).content.get("schema") == SCHEMA:
            first = path.read_text(encoding="utf-8").partition("\n")[0]
            profiles[path.stem] = first.lstrip("# ").partition(":")[0].partition(",")[0].rstrip(".")
    return profiles


def draft_bench(profile: str, answers: Answers, path: Path) -> BenchDraft:
    """Put the answers into a profile, keep its comments, and check the result.

    Parameters
    ----------
    profile
        Name among `list_profiles`.
    answers
        Values in place of the profile's values.

    Raises
    ------
    UsageError
        There is no such profile, or an answer does not belong to its link.
    ConfigurationError
        The result is not a valid bench configuration.
    """
    known = list_profiles()
    if profile not in known:
        raise UsageError(f"--profile is '{profile}', must be one of {', '.join(known)}")
    text = shipped(f"{profile}.yaml").read_text(encoding="utf-8")
    before = bench_of(Document(path, text))
    text = replace_values(path, text, _changes(before, answers))
    return BenchDraft(path, text, bench_of(Document(path, text)))


def _changes(bench: BenchConfig, answers: Answers) -> Mapping[tuple[str, ...], str | float | int]:
    """Answers by the path of the key that they change."""
    modbus_tcp = isinstance(bench.link, ModbusTcpLink | RtuOverTcpLink)
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


def probe_device(bench: BenchConfig) -> list[str]:
    """Read the identity of the device and return lines that describe it; writes no register."""
    lines = []
    link = bench.link
    if not isinstance(link, SerialLineLink) and (where := _where(link)):
        name = _name_of(link)
        lines.append(f"{where}: {name or 'nobody answers; is it switched on, is the address right?'}")
        if not name:
            return lines
    try:
        with opened_link(bench):
            lines.append("identity, map version and byte order: as the profile expects, as far as it names them")
    except PiezodError as error:
        lines.append(f"not as the profile expects: {error}")
    return lines


def _where(link: ModbusTcpLink | ModbusRtuLink | RtuOverTcpLink) -> str:
    """Address of a Modbus device whose name can be read; empty with TLS."""
    if isinstance(link, ModbusRtuLink):
        return link.port
    return "" if link.tls is not None else f"{link.host}:{link.port}"


def _name_of(link: ModbusTcpLink | ModbusRtuLink | RtuOverTcpLink) -> str:
    """Name of a Modbus device by function 43/14; empty: no device answers."""
    if isinstance(link, ModbusRtuLink):
        return rtu_name(link)
    return modbus_name(link.host, link.port, link.unit_id, rtu=isinstance(link, RtuOverTcpLink))


def discover(host: str | None, port: int | None, unit_id: int | None) -> list[str]:
    """Lines that list the serial ports of this machine, and the Modbus device at an address, which is only read.

    A serial port gets no request: it could disturb the device behind it.

    Parameters
    ----------
    host, port, unit_id
        Address of a device, read with TCP and with RTU frames; None: none, 502, and 1.
    """
    ports = serial_ports()
    lines = [f"serial port {port.path}: {port.description}" for port in ports] or ["no serial port was found"]
    if host is None:
        return lines
    number, unit = PLAIN_PORT if port is None else port, 1 if unit_id is None else unit_id
    for kind, rtu in (("modbus_tcp", False), ("rtu_over_tcp", True)):
        name = modbus_name(host, number, unit, rtu=rtu)
        if name and name != SILENT:
            return [*lines, f"{kind} {host}:{number} unit {unit}: {name}"]
    return [
        *lines,
        f"{host}:{number} unit {unit}: {name or 'nobody answers; is it switched on, is the address right?'}",
    ]


def write_bench(draft: BenchDraft, *, force: bool) -> None:
    """Write the file completely, or not at all.

    Parameters
    ----------
    force
        Whether to replace an existing file.

    Raises
    ------
    UsageError
        The file exists, and `force` is not set.
    ConfigurationError
        The file cannot be written.
    """
    path = draft.path
    try:
        written(path, draft.text, force=force)
    except FileExistsError:
        raise UsageError(f"{path} is there already; name another with -o, or replace it with --force") from None
