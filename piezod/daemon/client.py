"""The other end of the daemon's socket: what `piezod status`, `arm`, `disarm`, `stop`, `reset` and `reload` send."""

import json
import socket
import time
from pathlib import Path
from typing import Any

from piezod.config import load_bench
from piezod.errors import CheckFailedError, TemporaryError, UnreachableError, UsageError

ANSWER_WITHIN_S = 15.0
LOOK_AGAIN_S = 0.1
_FOLDERS = (Path("/run/piezod"), Path("/dev/shm"))  # noqa: S108  # where daemons listen unless told otherwise
_MOVING = ("ARMING", "RAMP_DOWN")


def socket_of(config: Path | None, named: Path | None) -> Path:
    """Where the daemon listens: as named, as the bench configuration says, or the only socket that there is.

    Raises
    ------
    UsageError
        Both are given.
    UnreachableError
        Nothing is given, and there is no socket or more than one.
    """
    if config is not None and named is not None:
        raise UsageError("CONFIG and --socket are both given; one says where the daemon listens")
    if named is not None:
        return named
    if config is not None:
        return load_bench(config).socket_path
    found = sorted(path for folder in _FOLDERS for path in folder.glob("*.sock") if path.is_socket())
    if len(found) != 1:
        which = ", ".join(map(str, found)) if found else f"none in {' or '.join(map(str, _FOLDERS))}"
        raise UnreachableError(f"no single daemon's socket: {which}; give CONFIG or --socket PATH")
    return found[0]


class Client:
    """One connection to a daemon.

    Parameters
    ----------
    path
        Its socket.

    Raises
    ------
    UnreachableError
        Nobody listens there.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        self._socket.settimeout(ANSWER_WITHIN_S)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            reason = error.strerror or str(error)
            advice = "are you in its group?" if isinstance(error, PermissionError) else "is the daemon running?"
            raise UnreachableError(f"{path}: {reason}: {advice}") from error
        self._lines = self._socket.makefile("rb")

    def ask(self, command: str) -> dict[str, Any]:
        """Send a command and return what the daemon answers.

        Raises
        ------
        CheckFailedError, TemporaryError, UsageError
            The daemon refuses, in its own words.
        UnreachableError
            It does not answer.
        """
        try:
            self._socket.sendall(json.dumps({"command": command}).encode() + b"\n")
            line = self._lines.readline()
        except OSError as error:
            raise UnreachableError(f"{self._path}: the daemon did not answer: {error}; try again") from error
        if not line:
            raise UnreachableError(f"{self._path}: the daemon hung up; see its log")
        answer: dict[str, Any] = json.loads(line)
        if not answer.get("ok"):
            kinds = {2: UsageError, 75: TemporaryError}
            raise kinds.get(answer.get("code", 1), CheckFailedError)(str(answer.get("error", "refused")))
        return answer

    def settled(self) -> dict[str, Any]:
        """Wait until the bench neither arms nor ramps down, and return its status."""
        while True:
            time.sleep(LOOK_AGAIN_S)
            status = self.ask("status")
            if status["state"] not in _MOVING:
                return status

    def close(self) -> None:
        """Hang up."""
        self._lines.close()
        self._socket.close()


def command_and_wait(path: Path, name: str, *, wait: bool) -> dict[str, Any]:
    """Send a command; when asked to, wait for what comes of it and return the status then."""
    client = Client(path)
    try:
        answer = client.ask(name)
        return answer | client.settled() if wait and name in ("arm", "disarm", "stop") else answer
    finally:
        client.close()


def status_text(status: dict[str, Any]) -> str:
    """The status in lines for people."""
    lines = [f"{status['bench']}: {status['state']}, {status['cause']}"]
    if status["problem"]:
        lines.append(f"  {status['problem']}")
    values = (
        ("force_N", "N"),
        ("reference_N", "N"),
        ("voltage_V", "V"),
        ("readback_V", "V"),
        ("temperature_C", "degC"),
    )
    known = [
        f"{name.rpartition('_')[0]} {status[name]:.2f} {unit}" for name, unit in values if status[name] is not None
    ]
    if known:
        lines.append("  " + ", ".join(known))
    lines.append(
        f"  {status['ticks']} ticks at {status['rate_Hz']:g} Hz, {status['missed']} missed, "
        f"{status['failed_exchanges']} failed exchanges; up {status['up_s']:.0f} s"
    )
    if status.get("corrected_force_N") is not None and status["force_N"] is not None:
        lines.append(f"  corrected for the load cell {status['corrected_force_N']:.2f} N; limits judge the raw reading")
    if drift := status.get("drift"):
        lines.append(f"  {_drift_text(drift)}")
    if recorder := status.get("recorder"):
        lines.append(f"  {_recorder_text(recorder)}")
    return "\n".join(lines)


def _drift_text(drift: dict[str, Any]) -> str:
    if drift["rms_N"] is None:
        return f"model: nothing compared yet, limit {drift['limit_N']:.2f} N"
    found = f"{drift['rms_N']:.2f} N rms, {drift['offset_N']:+.2f} N in the mean, limit {drift['limit_N']:.2f} N"
    if not drift["drifted"]:
        return f"model: holds; {found}"
    problem = f" ({drift['problem']})" if drift["problem"] else ""
    return f"model: DRIFTED; {found}; kept in {drift['kept']}{problem}; piezod diagnose --from-bench"


def _recorder_text(recorder: dict[str, Any]) -> str:
    lost = f", {recorder['dropped']} lost" if recorder["dropped"] else ""
    if recorder["degraded"]:
        return f"recorder DEGRADED: {recorder['problem']}; {recorder['rows']} ticks kept{lost}"
    return f"recorded {recorder['rows']} ticks{lost}; {recorder['file'] or 'no file yet'}"
