"""Rules for a configuration that is read again while the daemon runs.

- `name`, `daemon` and `recorder` never change.
- All other keys change when the bench is not connected, or disarmed. A disarmed control process is started again.
- In any other state only `limits` change, each of them only to a tighter value.
"""

from pathlib import Path

from piezod.config import BenchConfig, loosened_limit
from piezod.control import State
from piezod.errors import CheckFailedError


def check_restart_keys(old: BenchConfig, new: BenchConfig) -> None:
    """Refuse a change of a section that only a restart of the daemon can apply.

    Parameters
    ----------
    old, new
        Present configuration, and the configuration in the file.

    Raises
    ------
    CheckFailedError
        `name`, `daemon` or `recorder` has changed.
    """
    if (new.name, new.daemon, new.recorder) != (old.name, old.daemon, old.recorder):
        raise CheckFailedError("reload: name, daemon and recorder can only change with a restart; nothing was changed")


def check_armed_change(old: BenchConfig, new: BenchConfig, state: State, *, is_other_model: bool) -> None:
    """Refuse every change but tighter limits, for a bench that is not disarmed.

    Parameters
    ----------
    old, new
        Present configuration, and the configuration in the file.
    state
        State of the bench, for the message.
    is_other_model
        Whether the content of the model file has changed.

    Raises
    ------
    CheckFailedError
        More than the limits has changed, or a limit is looser than before.
    """
    if new.model_copy(update={"limits": old.limits}) != old or is_other_model:
        raise CheckFailedError(f"reload: while {state.name} only limits may change; disarm first")
    if looser := loosened_limit(old.limits, new.limits):
        raise CheckFailedError(f"reload: {looser}")


def file_content(path: Path) -> bytes:
    """Content of a file, for a comparison; empty if it cannot be read: loading it reports the error.

    Parameters
    ----------
    path
        File to read.
    """
    try:
        return path.read_bytes()
    except OSError:
        return b""
