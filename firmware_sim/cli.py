"""`python -m firmware_sim CONFIG`: serve the emulated bench."""

import argparse
import asyncio
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_sim.config import EmulatorConfig, Line, Rtu, Tcp, load_config
from firmware_sim.errors import ConfigurationError, PortBusyError
from firmware_sim.physics.effects import Effects
from firmware_sim.server import build_device, serve, use_realtime_priority

EXIT_BUSY = 75
EXIT_CONFIGURATION = 78


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the bench that the command line names; return the exit code.

    Parameters
    ----------
    arguments
        Command line without the program's name; None: that of the process.
    """
    options = _parser().parse_args(arguments)
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # errors of a client are not errors of the bench
    try:
        config = _adjusted(load_config(options.config), options)
        device = build_device(config, tuple(options.effect))
        if config.time == "real":
            use_realtime_priority()
        asyncio.run(serve(config, device, until_stdin_closes=options.until_stdin_closes))
    except ConfigurationError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_CONFIGURATION
    except PortBusyError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_BUSY
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m firmware_sim", description="Serve an emulated piezo bench.")
    parser.add_argument("config", type=Path, help="configuration file, such as config/emulator.yaml")
    parser.add_argument("--port", type=int, help="Modbus TCP port; 0 takes a free port")
    parser.add_argument("--rtu", action="store_true", help="also serve Modbus RTU on a pseudo-terminal")
    parser.add_argument("--line", action="store_true", help="also serve the line protocol on a pseudo-terminal")
    parser.add_argument(
        "--time",
        choices=("real", "virtual"),
        help="device time follows the clock (real) or the writes of the set point (virtual)",
    )
    parser.add_argument("--seed", type=int, help="seed of noise and phases")
    parser.add_argument("--scenario", help="stack, seed_bench, or a YAML file")
    parser.add_argument(
        "--effect", action="append", default=[], metavar="NAME", choices=tuple(Effects.model_fields),
        help="switch an effect on at its default strength; may be repeated",
    )  # fmt: skip
    parser.add_argument("--until-stdin-closes", action="store_true", help="end when standard input ends")
    return parser


def _adjusted(config: EmulatorConfig, options: argparse.Namespace) -> EmulatorConfig:
    """Return the configuration with the options of the command line applied."""
    changes: dict[str, object] = {
        name: getattr(options, name) for name in ("time", "seed", "scenario") if getattr(options, name) is not None
    }
    if options.port is not None:
        changes["tcp"] = (config.tcp or Tcp()).model_copy(update={"port": options.port})
    if options.rtu and config.rtu is None:
        changes["rtu"] = Rtu()
    if options.line and config.line is None:
        changes["line"] = Line()
    return config.model_copy(update=changes)
