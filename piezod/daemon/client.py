"""Client of the daemon's socket, for `piezod status`, `arm`, `disarm`, `stop`, `reset` and `reload`."""

import contextlib
import json
import socket
from pathlib import Path
from typing import Any

from piezod.config import load_bench
from piezod.config.run_time_files import SERVICE, SHARED
from piezod.daemon.stop_path import COMMANDS as URGENT
from piezod.daemon.stop_path import urge
from piezod.errors import CheckFailedError, TemporaryError, UnreachableError, UsageError
from piezod.runtime import clock, sockets

ANSWER_WITHIN_S = 15.0  # longest time to wait for an answer of the daemon [s]
URGE_WITHIN_S = 2.0  # longest time to wait for the stop socket [s]
POLL_INTERVAL_S = 0.1  # time between two status requests while the bench arms or ramps down [s]
QUEUE_INTERVAL_S = 0.01  # time between two attempts to connect while other clients wait to be accepted [s]
_FOLDERS = (SERVICE, SHARED)  # default folders of the daemon's socket
_MOVING = ("ARMING", "RAMP_DOWN")


def find_socket(config: Path | None, named: Path | None) -> Path:
    """Find the socket of the daemon: the named one, the one in the bench configuration, or the only one.

    Parameters
    ----------
    config
        Bench configuration; None: not given.
    named
        Path of the socket; None: not given.

    Raises
    ------
    UsageError
        Both are given.
    UnreachableError
        Neither is given, and there is no socket, or there are several.
    """
    if config is not None and named is not None:
        raise UsageError("CONFIG and --socket are both given; give one of them")
    if named is not None:
        return named
    if config is not None:
        return load_bench(config).socket_path
    found = sorted(path for folder in _FOLDERS for path in folder.glob("*.sock") if path.is_socket())
    if len(found) != 1:
        which = ", ".join(map(str, found)) if found else f"none in {' or '.join(map(str, _FOLDERS))}"
        raise UnreachableError(f"sockets of daemons: {which}; must be one: give CONFIG or --socket PATH")
    return found[0]


class Client:
    """Connection to a daemon.

    Parameters
    ----------
    path
        Socket of the daemon.

    Raises
    ------
    UnreachableError
        No daemon listens there.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = sockets.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        self._socket.settimeout(ANSWER_WITHIN_S)
        try:
            self._connect()
        except OSError as error:
            self._socket.close()
            reason = error.strerror or str(error)
            advice = "are you in its group?" if isinstance(error, PermissionError) else "is the daemon running?"
            raise UnreachableError(f"{path}: {reason}: {advice}") from error
        self._lines = self._socket.makefile("rb")

    def _connect(self) -> None:
        """Connect; wait while the queue of the socket is full, which the kernel reports as an error."""
        deadline_s = clock.monotonic() + ANSWER_WITHIN_S
        while True:
            try:
                self._socket.connect(str(self._path))
            except BlockingIOError:
                if clock.monotonic() > deadline_s:
                    raise
                clock.sleep(QUEUE_INTERVAL_S)
            else:
                return

    def ask(self, command: str) -> dict[str, Any]:
        """Send a command and return the answer of the daemon.

        Parameters
        ----------
        command
            `status`, `log`, `arm`, `disarm`, `stop`, `reset` or `reload`.

        Raises
        ------
        CheckFailedError, TemporaryError, UsageError
            The daemon refuses the command; the text is its reason.
        UnreachableError
            The daemon does not answer.
        """
        try:
            self._socket.sendall(json.dumps({"command": command}).encode() + b"\n")
            line = self._lines.readline()
        except OSError as error:
            raise UnreachableError(f"{self._path}: the daemon did not answer: {error}; try again") from error
        if not line:
            raise UnreachableError(f"{self._path}: the daemon closed the connection; see its log")
        answer: dict[str, Any] = json.loads(line)
        if not answer.get("ok"):
            kinds = {2: UsageError, 75: TemporaryError}
            raise kinds.get(answer.get("code", 1), CheckFailedError)(str(answer.get("error", "refused")))
        return answer

    def wait_until_settled(self) -> dict[str, Any]:
        """Wait until the bench neither arms nor ramps down, and return its status."""
        while True:
            clock.sleep(POLL_INTERVAL_S)
            status = self.ask("status")
            if status["state"] not in _MOVING:
                return status

    def close(self) -> None:
        """Close the connection."""
        self._lines.close()
        self._socket.close()


def command_and_wait(path: Path, name: str, *, wait: bool) -> dict[str, Any]:
    """Send a command and return its answer.

    Parameters
    ----------
    path
        Socket of the daemon.
    name
        Command, as in `Client.ask`.
    wait
        Whether to wait until `arm`, `disarm` or `stop` is complete; the status then is part of the result.
    """
    urged, stop_socket = "", path.with_name(path.name + ".stop")
    if name in URGENT:
        with contextlib.suppress(TemporaryError):  # the answer below reports the result
            urged = urge(stop_socket, name, URGE_WITHIN_S)
    try:
        with contextlib.closing(Client(path)) as client:
            answer = client.ask(name)
            return answer | client.wait_until_settled() if wait and name in ("arm", "disarm", "stop") else answer
    except UnreachableError:
        if not urged or stop_socket.exists():  # a service removes it at its end; one that hangs or was killed does not
            raise
        return {"ok": True, "message": f"{urged}; the command that drove has ended"}
