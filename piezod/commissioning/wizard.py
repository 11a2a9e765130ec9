"""Questions of `piezod init` on a terminal."""

from dataclasses import replace

import typer

from piezod.commissioning.init import Answers, list_profiles
from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.config.link import ModbusTcpLink, RtuOverTcpLink
from piezod.transport.probe import serial_ports


def ask_missing(profile: str | None, given: Answers) -> tuple[str, Answers]:
    """Ask for the profile and the answers that are missing, with the values of the profile as defaults.

    Parameters
    ----------
    profile
        Name of the profile; None: not given.
    given
        Answers that the options contain.

    Returns
    -------
    tuple
        Name of the profile, and all answers.
    """
    known = list_profiles()
    if profile not in known:
        for name, device in known.items():
            typer.echo(f"  {name:22} {device}")
        profile = typer.prompt("device profile", default="bench")
    if profile not in known:
        return str(profile), given  # `draft_bench` refuses it
    bench = load_bench(shipped(f"{profile}.yaml"))
    answers = replace(given, name=given.name or typer.prompt("name of the bench", default=bench.name))
    link = bench.link
    if isinstance(link, ModbusTcpLink | RtuOverTcpLink):
        answers = replace(
            answers,
            host=given.host or typer.prompt("address of the device", default=link.host),
            port=given.port or typer.prompt("its port", default=link.port, type=int),
            unit_id=link.unit_id if given.unit_id is None else given.unit_id,
        )
    else:
        answers = replace(answers, serial=given.serial or _serial_port(link.port))
    cell, limits = bench.load_cell_link, bench.limits
    if isinstance(cell, ModbusTcpLink):
        host = given.load_cell_host or typer.prompt("address of the load cell's device", default=cell.host)
        answers = replace(answers, load_cell_host=host)
    return profile, replace(
        answers,
        rate_Hz=given.rate_Hz or typer.prompt("ticks per second [Hz]", default=bench.rate_Hz, type=float),
        voltage_max_V=given.voltage_max_V
        or typer.prompt("highest voltage of the stack [V]", default=limits.voltage_max_V, type=float),
        force_trip_N=given.force_trip_N
        or typer.prompt("trip when the force is above [N]", default=limits.force_trip_N, type=float),
    )


def _serial_port(default: str) -> str:
    """Ask for a serial port: the number of a listed port, or any path."""
    ports = serial_ports()
    for number, port in enumerate(ports, 1):
        typer.echo(f"  {number}  {port.path}  ({port.description})")
    answer: str = typer.prompt("serial port, by number or path", default=ports[0].path if ports else default)
    return ports[int(answer) - 1].path if answer.isdigit() and 0 < int(answer) <= len(ports) else answer
