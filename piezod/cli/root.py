"""What all commands share: the root, arguments and options, and how an error is told."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from piezod import __version__
from piezod.errors import PiezodError, UsageError

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
