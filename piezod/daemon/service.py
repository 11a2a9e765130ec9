"""The parent of the control process: it answers, counts and notifies, and cannot slow a tick.

Without `--arm` it stays until it is told to end: disarmed, waiting for a device that does not answer, driving when told
to over its socket. With `--arm` it drives the reference once and ends with it.
"""

import asyncio
import contextlib
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from piezod import __version__
from piezod.config import BenchConfig, loosened_limit, model_path
from piezod.control import CAUSE_TEXT, Cause, State
from piezod.daemon.control_socket import ControlSocket, Peer
from piezod.daemon.journal import say
from piezod.daemon.metrics import BenchMetrics, MetricsServer
from piezod.daemon.model_watch import ModelWatch
from piezod.daemon.statistics import Tally
from piezod.daemon.systemd import Notifier
from piezod.errors import CheckFailedError, PiezodError, TemporaryError
from piezod.recorder.watch import RecorderWatch
from piezod.session.assembly import load
from piezod.session.lock import BenchLock
from piezod.session.session import LOOK_EVERY_S, Session, deliberate_error
from piezod.session.task import Outcome

RETRY_S = (0.5, 1.0, 2.0, 5.0, 10.0)  # then every ten seconds
READY_WITHIN_S = 30.0  # a control process that is not connected then hangs, and systemd may know
ANSWER_WITHIN_S = 10.0
COMMANDS = ("status", "arm", "disarm", "stop", "reset", "reload")


class Service:
    """One bench, served until it is told to end.

    Parameters
    ----------
    path, bench
        The configuration file and what was read from it.
    lock
        Held until the end.
    session
        A first control process, launched already: it starts while this module is being imported.
    arm
        Drive at once, and end with the reference.
    """

    def __init__(self, path: Path, bench: BenchConfig, lock: BenchLock, session: Session, *, arm: bool) -> None:
        self._path, self._bench, self._lock = path, bench, lock
        self._model_text = _text_of(model_path(bench, path))
        self._arm = arm
        self._begun_s = time.monotonic()
        self._notifier = Notifier()
        self._session: Session | None = session
        self._messages: asyncio.Queue[tuple[str, Any]] = asyncio.Queue()
        self._answers: dict[int, asyncio.Future[tuple[str, str]]] = {}
        self._busy = asyncio.Lock()
        self._wake = asyncio.Event()
        self._stops = 0
        self._reloading = False
        self._problem = ""
        self._connected = False
        self.outcome = Outcome()
        self.tally = Tally(self._tell)
        self._recorder = None if bench.recorder is None else RecorderWatch(bench, say)
        self.model_watch = ModelWatch(path)

    async def run(self) -> None:
        """Answer, and follow one control process after the other, until told to end."""
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(self._notifier.close)
            self._hear_signals()
            if self._recorder is not None:
                stack.push_async_callback(self._recorder.close)
            control_socket = ControlSocket(self._bench, self._answer, say)
            stack.push_async_callback(control_socket.close)
            await control_socket.open()
            if self._bench.daemon.metrics_port is not None:
                shown = BenchMetrics(self._bench.name, self.tally, self._recorder, lambda: self.model_watch.drift)
                metrics = MetricsServer(shown, say)
                stack.push_async_callback(metrics.close)
                await metrics.open(self._bench.daemon.metrics_port)
            await self._sessions()

    def _hear_signals(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._stop)
        loop.add_signal_handler(signal.SIGHUP, lambda: loop.create_task(self._hang_up()))

    def _stop(self) -> None:
        """Ramp down and end; each further one in haste."""
        self._stops += 1
        self._notifier.stopping()
        self._wake.set()
        if self._session is not None and self._connected:
            self._session.stop()

    async def _sessions(self) -> None:
        """One control process after the other: again after a failed start, or when the configuration was reloaded."""
        attempt, again = 0, True
        while again and not self._stops:
            self._reloading = again = False
            session = self._session
            if session is None:
                session = Session(self._bench, None, self._path.parent, [], serves=self._path, lock=self._lock)
                session.launch()
            try:
                await self._one_session(session)
                attempt = 0
            except TemporaryError as error:
                if self._arm or self._connected:
                    raise
                await self._wait_to_retry(error, RETRY_S[min(attempt, len(RETRY_S) - 1)])
                attempt, again = attempt + 1, True
            finally:
                self._connected = False
                self._session = None
                session.close()
            again = again or self._reloading

    async def _wait_to_retry(self, error: TemporaryError, pause_s: float) -> None:
        """Stay up and disarmed; there is no tick to be healthy, so the parent answers for itself."""
        if self._problem != str(error):
            say(f"{error}; trying again")
        self._problem = str(error)
        self._notifier.ready()
        self._notifier.status(f"DISARMED, {error}; trying again")
        deadline_s = time.monotonic() + pause_s
        while (left_s := deadline_s - time.monotonic()) > 0 and not self._wake.is_set():
            self._notifier.alive()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), min(left_s, 0.5))
        self._wake.clear()

    async def _one_session(self, session: Session) -> None:
        self._session = session
        loop = asyncio.get_running_loop()
        self._messages = asyncio.Queue()
        descriptor = session.descriptor
        loop.add_reader(descriptor, self._receive, session, descriptor)
        try:
            kind, content = await self._until_ready()
            if kind != "ready":
                return
            session.open_ring()
            self._connected = True
            self._problem = ""
            if self._recorder is not None:
                self._recorder.follow(self._bench.ring_log_path)
            self.tally.begin()
            self.model_watch.begin(self._bench)
            self._notifier.ready()
            self._notifier.status(f"DISARMED, {content}")
            if self._stops:
                session.stop()
            arming = loop.create_task(self._arm_at_once(session)) if self._arm else None
            if arming is None:
                say(f"{self._bench.name}: {self._bench.rate_Hz:g} Hz, reading only; arm with: piezod arm {self._path}")
            await self._follow(session)
            if arming is not None:
                await arming
        finally:
            loop.remove_reader(descriptor)
            await self.model_watch.end()

    def _receive(self, session: Session, descriptor: int) -> None:
        """Take one message of the control process; called when there is one."""
        kind, content = session.receive()
        if kind == "answer":
            number, *answer = content
            self._settle(number, (answer[0], answer[1]))
            return
        if kind in ("done", "error"):
            asyncio.get_running_loop().remove_reader(descriptor)
            for number in list(self._answers):
                self._settle(number, ("TemporaryError", "the control process has ended"))
        self._messages.put_nowait((kind, content))

    def _settle(self, number: int, answer: tuple[str, str]) -> None:
        """Hand an answer to whoever waits for it; one that came too late is dropped."""
        waiting = self._answers.get(number)
        if waiting is not None and not waiting.done():
            waiting.set_result(answer)

    async def _until_ready(self) -> tuple[str, Any]:
        """Wait for the control process; a stop meanwhile ends it, and is no error."""
        begun_s = time.monotonic()
        while self._messages.empty():
            if time.monotonic() - begun_s < READY_WITHIN_S:
                self._notifier.alive()
            if self._stops and self._session is not None:
                self._session.stop()
            await asyncio.sleep(LOOK_EVERY_S / 10)
        kind, content = self._messages.get_nowait()
        if kind == "error" and not self._stops:
            raise deliberate_error(*content)
        return kind, content

    async def _arm_at_once(self, session: Session) -> None:
        try:
            await self._command("arm")
        except PiezodError:
            session.stop()
            raise
        say(f"{self._bench.name}: {self._bench.rate_Hz:g} Hz, armed")

    async def _follow(self, session: Session) -> None:
        """Look at the ring log until the control process ends."""
        begun_s = time.monotonic()
        while self._messages.empty():
            starting = (
                self.tally.last is None and time.monotonic() - begun_s < READY_WITHIN_S
            )  # steps are compiled once
            if self._look(session) or starting:
                self._notifier.alive()
            if self._arm and self.tally.was_driving and self.tally.state in (State.DISARMED, State.FAULT):
                session.stop()
                self._arm = False
            if self._recorder is not None:
                self._recorder.look()
            await asyncio.sleep(LOOK_EVERY_S)
        self._look(session)
        kind, content = self._messages.get_nowait()
        if kind == "error":
            raise deliberate_error(*content)
        self.outcome = content

    def _look(self, session: Session) -> bool:
        """Take in what the ring log has; False when the loop has not ticked since."""
        rows = session.read()
        self.tally.add(rows)
        self.model_watch.add(rows)
        return bool(rows.size)

    def _tell(self, state: State, cause: Cause, row: np.void) -> None:
        """Say a transition, once."""
        text = f"{state.name}: {CAUSE_TEXT[cause]}"
        say(f"{text} (force {row['force_N']:.2f} N, voltage {row['voltage_V']:.2f} V)")
        self._notifier.status(text)

    async def _command(self, name: str, argument: object = None) -> str:
        """Have the control process do something; one command at a time.

        Raises
        ------
        PiezodError
            It refuses, or nobody is there.
        """
        async with self._busy:
            session = self._session
            if session is None or not self._connected:
                raise TemporaryError(f"{name}: the device is not connected: {self._problem or 'starting'}; try again")
            number = session.command(name, argument)
            self._answers[number] = asyncio.get_running_loop().create_future()
            try:
                kind, text = await asyncio.wait_for(self._answers[number], ANSWER_WITHIN_S)
            except TimeoutError:
                raise TemporaryError(f"{name}: the control process did not answer; see piezod status") from None
            finally:
                del self._answers[number]
            if kind != "ok":
                raise deliberate_error(kind, text)
            await asyncio.sleep(2 * self._bench.dt_s)  # so that the next status tells what came of it
            return text

    async def _answer(self, command: str, peer: Peer) -> dict[str, object]:
        """Answer one command of the socket."""
        if command == "status":
            return {"ok": True, **self.status()}
        if command not in COMMANDS:
            return {"ok": False, "error": f"command is {command!r}, must be one of {', '.join(COMMANDS)}", "code": 2}
        try:
            message = await (self._reload() if command == "reload" else self._command(command))
        except PiezodError as error:
            say(f"socket: {command} by {peer}: refused: {error}")
            return {"ok": False, "error": str(error), "code": error.exit_code}
        say(f"socket: {command} by {peer}: {message}")
        return {"ok": True, "message": message}

    def status(self) -> dict[str, object]:
        """What the bench does, for `piezod status`."""
        if self._session is not None and self._connected:
            self._look(self._session)
        drift, preview = self.model_watch.drift, self.model_watch.preview
        return {
            "schema": "piezod.status/1",
            "version": __version__,
            "bench": self._bench.name,
            "config": str(self._path.resolve()),
            "rate_Hz": self._bench.rate_Hz,
            "connected": self._connected,
            "problem": self._problem,
            "up_s": round(time.monotonic() - self._begun_s, 3),
            "rows_dropped": 0 if self._session is None else self._session.dropped,
            "recorder": None if self._recorder is None else self._recorder.as_dict(),
            "drift": None if drift is None else drift.as_dict(),
            "preview": None if preview is None else preview.as_dict(),
            "corrected_force_N": None if drift is None else drift.corrected(),
            **self.tally.as_dict(),
        }

    async def _hang_up(self) -> None:
        """SIGHUP: read the configuration again."""
        self._notifier.reloading()
        try:
            say(f"reload: {await self._reload()}")
        except PiezodError as error:
            say(f"reload refused, the old configuration stays: {error}")
            self._notifier.status(f"reload refused: {error}")
        finally:
            self._notifier.ready()

    async def _reload(self) -> str:
        """Take the configuration file as it is now: all of it when disarmed, tighter limits only while armed."""
        bench, _ = load(self._path)
        old, model_text = self._bench, _text_of(model_path(bench, self._path))
        if (bench.name, bench.daemon, bench.recorder) != (old.name, old.daemon, old.recorder):
            raise CheckFailedError(
                "reload: name, daemon and recorder can only change with a restart; nothing was changed"
            )
        if bench == old and model_text == self._model_text:
            return "nothing has changed"
        if self._session is None or not self._connected:
            self._bench, self._model_text = bench, model_text
            self._wake.set()
            return "configuration taken"
        if self.status()["state"] == State.DISARMED.name and not self._arm:
            before = old, self._model_text
            self._bench, self._model_text, self._reloading = bench, model_text, True
            try:
                await self._command("end")
            except PiezodError:
                (self._bench, self._model_text), self._reloading = before, False
                raise
            return "configuration taken; starting again, disarmed"
        if bench.model_copy(update={"limits": old.limits}) != old or model_text != self._model_text:
            raise CheckFailedError(f"reload: while {self.tally.state.name} only limits may change; disarm first")
        if looser := loosened_limit(old.limits, bench.limits):
            raise CheckFailedError(f"reload: {looser}")
        answer = await self._command("limits", bench.limits)
        self._bench = bench
        return answer


def _text_of(path: Path) -> bytes:
    """What a file holds, to be compared; nothing if it cannot be read: whoever needs it will say so."""
    try:
        return path.read_bytes()
    except OSError:
        return b""
