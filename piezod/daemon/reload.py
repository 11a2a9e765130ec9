"""Rules for a configuration that is read again while the daemon runs.

- `name`, `daemon` and `recorder` never change.
- While a control process starts, nothing changes: it has the former configuration and would drive with it.
- All other keys change when no control process runs, or when it is disarmed. It is then started again.
- In any other state only `limits` change, each of them only to a tighter value.
"""

from piezod.config import BenchConfig
from piezod.config.limits import loosened_limit
from piezod.control import State
from piezod.errors import CheckFailedError, TemporaryError


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


def check_settled(*, connected: bool, ended: bool, problem: str) -> None:
    """Refuse a reload while a control process starts or ends.

    Parameters
    ----------
    connected, ended
        Whether the control process is connected to the device, and whether it has ended.
    problem
        Why it is not connected; empty at the first start.

    Raises
    ------
    TemporaryError
        The control process has the former configuration, and has not reported that it is connected.
    """
    if not connected or ended:
        reason = f" ({problem})" if problem and not ended else ""
        raise TemporaryError(
            f"reload: the control process is {'ending' if ended else 'starting'} with the former "
            f"configuration{reason}; nothing was changed, try again"
        )


def check_armed_change(old: BenchConfig, new: BenchConfig, state: State, *, is_other_file: bool) -> None:
    """Refuse every change but tighter limits, for a bench that is not disarmed.

    Parameters
    ----------
    old, new
        Present configuration, and the configuration in the file.
    state
        State of the bench, for the message.
    is_other_file
        Whether the content of the model or of the reference file has changed.

    Raises
    ------
    CheckFailedError
        More than the limits has changed, or a limit is looser than before.
    """
    first = "piezod reset first" if state is State.FAULT else "disarm first"
    if new.model_copy(update={"limits": old.limits}) != old or is_other_file:
        raise CheckFailedError(f"reload: while {state.name} only limits may change; {first}")
    if looser := loosened_limit(old.limits, new.limits):
        raise CheckFailedError(f"reload: while {state.name} {looser}; {first}")
