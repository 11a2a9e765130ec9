"""Parts that all commands share: the command `piezod`, common arguments and options, and the output of an error."""

import atexit
import errno
import gc
import os
import platform
import signal
import sys
from collections.abc import Callable
from importlib.metadata import version as version_of
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from piezod import __version__
from piezod.cli import INTERRUPTED
from piezod.errors import PiezodError, RecordingError, TemporaryError, UsageError

try:
    import resource  # now: a process without free descriptors cannot import it
except ModuleNotFoundError:  # Windows
    resource = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from piezod.recording import TextOptions

Handler = Callable[[int, FrameType | None], object]

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
    typer.Option(
        "--columns",
        metavar="NAME,...",
        help="Names of all columns, time_ms,voltage_V,force_N, or of some: time_s=run1/t,...",
    ),
]
RateOption = Annotated[
    float | None,
    typer.Option("--rate-Hz", metavar="HZ", min=1e-9, help="Rate of a file without a column of time."),
]
DecimalOption = Annotated[
    str | None, typer.Option("--decimal", metavar="MARK", help="Decimal mark of a text file, a point or a comma.")
]
ScaleOption = Annotated[
    list[str] | None,
    typer.Option("--scale", metavar="COLUMN=FACTOR UNIT", help="Conversion of a column, such as 'CH2=100 N/V'."),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace existing files.")]
WaitOption = Annotated[bool, typer.Option(help="Wait for the result.")]


_POSIX_MODULES = ("fcntl", "grp", "pwd", "resource", "termios", "tty")
_Misused = typer.BadParameter.__mro__[2]  # base class in click of all errors in arguments


def main(on_interrupt: "Handler | None" = None) -> None:
    """Run a command; print a PiezodError as one line on stderr and end with its exit code.

    Parameters
    ----------
    on_interrupt
        Handler of Ctrl-C while the command runs; None: it stays as it is.
    """
    atexit.register(gc.freeze)  # the end of the interpreter visits every object otherwise, which takes 0.2 s
    try:
        if on_interrupt is not None:
            signal.signal(signal.SIGINT, on_interrupt)
        code = app(standalone_mode=False, prog_name="piezod")
        sys.exit(code if isinstance(code, int) else 0)
    except PiezodError as error:
        print(f"piezod: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(INTERRUPTED)
    except ModuleNotFoundError as error:
        if error.name not in _POSIX_MODULES:
            raise
        print(f"piezod: this command is for a bench and needs Linux: this system has no {error.name}", file=sys.stderr)
        sys.exit(PiezodError.exit_code)
    except Exception as error:
        if isinstance(error, _Misused):
            print(_misuse_text(error), file=sys.stderr)
            sys.exit(UsageError.exit_code)
        if (shortage := _shortage(error)) is None:
            raise
        print(f"piezod: {shortage}", file=sys.stderr)
        sys.exit(TemporaryError.exit_code)


def _shortage(error: BaseException) -> str | None:
    """One line for an error that a lack of descriptors or memory caused; None for any other error."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "the memory does not suffice; free some, or raise the limit (ulimit -v)"
        if getattr(cause, "errno", None) in (errno.EMFILE, errno.ENFILE) or os.strerror(errno.EMFILE) in str(cause):
            if resource is None:
                return "too many open files; end other programs"
            limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
            return f"too many open files, the limit is {limit}; raise it (ulimit -n 1024)"
        cause = cause.__cause__ or cause.__context__
    return None


def _misuse_text(error: Exception) -> str:
    """Error in the arguments as one line; the help text if no command was given."""
    context, text = getattr(error, "ctx", None), getattr(error, "format_message", lambda: str(error))()
    if context is not None and text.startswith("Usage:"):
        return str(text)
    path = "piezod" if context is None else context.command_path
    return f"piezod: {' '.join(text.split()).rstrip('.')}; see {path} --help"


def _version(wanted: bool) -> None:
    """Versions for a report of a fault: of the package, of its numerical libraries, and of the system."""
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


def check_readable(path: Path, model: Path, text: "TextOptions") -> None:
    """Refuse a recording that neither the user's layout nor a layout of the model's recordings fits.

    Parameters
    ----------
    path, model
        Files of the recording and of the model.
    text
        Layout of a text file as the user states it.

    Raises
    ------
    RecordingError, ModelError
        A file cannot be read.
    """
    from piezod.recording import column_names

    try:
        column_names(path, text)
    except RecordingError:
        from piezod.estimation.recordings.layout import layout_of
        from piezod.model import load_model

        layout_of(path, load_model(model), text)
