"""Parts that all commands share: the command `piezod`, common arguments and options, and the output of an error."""

import atexit
import gc
import platform
import sys
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Annotated

import typer

from piezod import __version__
from piezod.errors import PiezodError, UsageError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Feedforward force control for piezo stacks. Commands that read print JSON with --json.",
)

ConfigArgument = Annotated[Path, typer.Argument(metavar="CONFIG", help="Bench configuration, e.g. config/bench.yaml.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
DaemonArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="[CONFIG]", help="Bench configuration of the daemon; default: the only daemon on this machine."
    ),
]
SocketOption = Annotated[
    Path | None, typer.Option("--socket", metavar="PATH", help="Socket of the daemon, instead of CONFIG.")
]
ColumnsOption = Annotated[
    str | None,
    typer.Option("--columns", metavar="NAME,...", help="Columns of a text file, such as time_ms,voltage_V,force_N."),
]
RateOption = Annotated[
    float | None,
    typer.Option("--rate-Hz", metavar="HZ", min=1e-9, help="Rate of a text file without a column of time."),
]
DecimalOption = Annotated[
    str | None, typer.Option("--decimal", metavar="MARK", help="Decimal mark of a text file, a point or a comma.")
]
WaitOption = Annotated[bool, typer.Option(help="Wait for the result.")]


_Misused = typer.BadParameter.__mro__[2]  # base class in click of all errors in arguments


def main() -> None:
    """Run a command; print a PiezodError as one line on stderr and end with its exit code."""
    atexit.register(gc.freeze)  # the end of the interpreter visits every object otherwise, which takes 0.2 s
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
    """Error in the arguments as one line; the help text if no command was given."""
    context, text = getattr(error, "ctx", None), getattr(error, "format_message", lambda: str(error))()
    if context is not None and text.startswith("Usage:"):
        return str(text)
    path = "piezod" if context is None else context.command_path
    return f"piezod: {' '.join(text.split()).rstrip('.')}; see {path} --help"


def _version(wanted: bool) -> None:
    """What a report of a fault needs: versions of the package, of what it computes with, and of the system."""
    if wanted:
        libraries = ", ".join(f"{name} {version_of(name)}" for name in ("numba", "numpy"))
        python, system = platform.python_version(), f"{platform.system()} {platform.release()} {platform.machine()}"
        print(f"piezod {__version__} (Python {python}, {libraries}, {system})")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[  # handled by its callback
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Print the versions of piezod, Python, numba, numpy and the system.",
        ),
    ] = False,
) -> None:
    pass
