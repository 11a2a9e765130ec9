"""Commands of `piezod`: each one parses its arguments, calls one function of another room and prints the result.

This file imports no other room, so that Ctrl-C ends the command quietly from its first moment.
"""

import importlib
import os
import signal
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from piezod.cli.root import app

__all__ = ["app", "main"]

COMMANDS = ["demo", "setup", "running", "recordings", "models", "commissioning", "diagnosis", "history", "study"]
COMMANDS += ["documentation"]
"""Files with the commands, in the order in which `piezod --help` lists them."""

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT."""


def main() -> None:
    """Run the command line.

    While the commands are imported, Ctrl-C ends the process at once: no clean-up is needed, and an interrupted
    import would print a traceback.
    """
    is_default = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else the shell has it ignored
    if is_default:
        signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    _registered()
    from piezod.cli.root import main as run

    run(signal.default_int_handler if is_default else None)


def __getattr__(name: str) -> Any:  # noqa: ANN401  # the app, or an error
    """The app, imported at its first use."""
    if name == "app":
        return _registered()
    raise AttributeError(f"module 'piezod.cli' has no attribute {name!r}")


def _registered() -> Any:  # noqa: ANN401  # the app of typer
    """The app with all commands."""
    for name in COMMANDS:
        importlib.import_module(f"piezod.cli.{name}")
    return importlib.import_module("piezod.cli.root").app
