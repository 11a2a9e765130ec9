"""The daemon, parent of the control process: sessions, answers to clients, notifications. It cannot delay a tick.

Without `--arm` it runs until a signal ends it. It is disarmed, waits for a device that does not answer, and drives the
bench after the command `arm` on its socket. With `--arm` it drives the reference once and ends. A command that drives,
such as `piezod record`, is a service too: it drives the segments of its session and ends.
"""

import asyncio
import contextlib
import signal
from pathlib import Path
from typing import Any

import numpy as np

from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, State
from piezod.daemon.command_channel import CommandChannel
from piezod.daemon.control_socket import ControlSocket, Peer
from piezod.daemon.file_reader import read_bench_files
from piezod.daemon.journal import JOURNAL, log_line
from piezod.daemon.last_check import LastCheck
from piezod.daemon.metrics import BenchMetrics, MetricsServer
from piezod.daemon.model_watch import ModelWatch
from piezod.daemon.phase_watch import PhaseWatch
from piezod.daemon.proof_date import last_proof
from piezod.daemon.railed import RailedWatch
from piezod.daemon.reload import check_armed_change, check_restart_keys, check_settled
from piezod.daemon.statistics import TickStatistics
from piezod.daemon.status import reference_values, status_dict
from piezod.daemon.stop_path import COMMANDS as URGENT
from piezod.daemon.stop_path import StopPath
from piezod.daemon.systemd import Notifier
from piezod.errors import ConfigurationError, PiezodError, TemporaryError
from piezod.recorder.watch import RecorderWatch
from piezod.runtime import clock, signals
from piezod.session.assembly import correction_size
from piezod.session.history import OnRows
from piezod.session.lock import BenchLock
from piezod.session.session import Session, rebuild_error
from piezod.session.task import Outcome, Task

RETRY_S = (0.5, 1.0, 2.0, 5.0, 10.0)  # pauses after failed starts in a row [s]; the last value repeats
POLL_INTERVAL_S = 0.1  # time between two reads of the ring log [s]
CONNECTED_WITHIN_S = 120.0
"""Time for the start of a control process [s]: with an empty cache it compiles its steps before it is ready."""
READY_WITHIN_S = 30.0
"""Time for the first tick [s]. Afterwards a control process without ticks counts as hung, and systemd restarts it."""
FILES_INTERVAL_S = 0.5
"""Time between two looks at lock, sockets and ring log [s]: what is removed is noticed within a second."""
UNSTOPPABLE_S = 1.0
"""Time without a socket for a stop, from its discovery, after which the bench ramps down [s]; two seconds in all."""
UNFINISHED = {"incomplete": "the command that drove was killed"}  # metadata of the rows of such a command
DRIVING = (State.ARMING, State.RUNNING, State.HOLD)
ENDING = (signal.SIGTERM, signal.SIGINT)
HANDLED = (*ENDING, signal.SIGHUP)
COMMANDS = ("status", "log", "arm", "disarm", "stop", "reset", "reload")  # commands of the socket


class Service:
    """The daemon of one bench.

    Parameters
    ----------
    lock
        Lock of the bench, held until the end.
    session
        First session. Its control process has been launched, and starts while this module is being imported.
    arm
        Whether to arm at once and end with the reference.
    on_rows
        Called about ten times per second with new rows, shape (N,), by a command whose session drives segments. None:
        the bench file is served.
    is_unfinished
        Whether the files of the recorder are only needed if the command is killed.

    Attributes
    ----------
    outcome
        Outcome of the session that ended last.
    statistics
        Statistics of the ticks of all sessions.
    railed_watch
        Watch for a reference out of reach.
    phase_watch
        Durations of the phases of a tick.
    """

    def __init__(
        self,
        path: Path,
        bench: BenchConfig,
        lock: BenchLock,
        session: Session,
        *,
        arm: bool,
        on_rows: OnRows | None = None,
        is_unfinished: bool = False,
    ) -> None:
        self._on_rows = on_rows
        self._path, self._bench, self._lock = path, bench, lock
        self._files = ""
        self._next: BenchConfig | None = None
        self._launched = asyncio.Event()
        self._reload_lock = asyncio.Lock()
        self._arm = arm
        self._begun_s = clock.monotonic()
        self._notifier = Notifier()
        self._channel = CommandChannel(session)
        self._wake = asyncio.Event()
        self._control_socket = ControlSocket(bench, self._answer, log_line)
        self._stop_path = StopPath(bench, self._urge)
        self._arm_withdrawn = False
        self._files_problem = ""
        self._lock_lost = False
        self._files_seen_s = 0.0
        self._stoppable_s = self._begun_s
        self._stops_requested = 0
        self.outcome = Outcome()
        self.statistics = TickStatistics(self._log_transition)
        about = UNFINISHED if is_unfinished else {}
        self._recorder = None if bench.recorder is None else RecorderWatch(bench, log_line, about)
        self.model_watch = ModelWatch(path)
        self.railed_watch = RailedWatch(log_line)
        self.proof = last_proof(bench, path, lambda: self._bench)
        self.last_check = LastCheck.of(bench)
        self.phase_watch = PhaseWatch(log_line)

    async def run(self) -> None:
        """Serve the socket and run one session after the other until a signal ends the daemon."""
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(_ignore_signals)
            stack.callback(self._notifier.close)
            self._add_signal_handlers()
            if self._recorder is not None:
                stack.push_async_callback(self._recorder.close)
            stack.push_async_callback(self._control_socket.close)
            await self._control_socket.open()
            stack.callback(self._stop_path.close)
            self._stop_path.open()
            if self._bench.daemon.metrics_port is not None:
                shown = BenchMetrics(
                    self._bench.name,
                    self.statistics,
                    self._recorder,
                    lambda: self.model_watch.drift,
                    self.railed_watch,
                    lambda: reference_values(self._bench, self._channel),
                    self.phase_watch,
                    lambda: self.model_watch.learning,
                    self._bench.dt_s,
                    self.proof,
                    lambda: self._channel.counters,
                    self.last_check,
                )
                metrics = MetricsServer(shown, log_line)
                stack.push_async_callback(metrics.close)
                try:
                    await metrics.open(self._bench.daemon.metrics_port)
                except PiezodError:
                    if self._on_rows is None:  # a command of a minute drives without metrics
                        raise
            await self._run_sessions()

    def status(self) -> dict[str, object]:
        """Status of the bench, for `piezod status`."""
        if self._channel.session is not None and self._channel.connected:
            self._read_rows(self._channel.session)
        up_s = clock.monotonic() - self._begun_s
        return status_dict(
            self._bench,
            self._path,
            self._channel,
            self.statistics,
            self._recorder,
            self.model_watch,
            self.railed_watch,
            self.phase_watch,
            self.proof,
            self.last_check,
            up_s,
        )

    def _add_signal_handlers(self) -> None:
        """Handle signals; those that end the daemon act at once, also while the event loop waits for something."""
        loop = asyncio.get_running_loop()
        for number in ENDING if self._on_rows is None else HANDLED:
            signals.handle(number, lambda *_: self._stop(loop))
        if self._on_rows is None:
            loop.add_signal_handler(signal.SIGHUP, self._begin_reload)

    def _begin_reload(self) -> None:
        """Reload, unless the daemon is ending."""
        if not self._stops_requested:
            asyncio.get_running_loop().create_task(self._reload_on_signal())

    def _stop(self, loop: asyncio.AbstractEventLoop) -> None:
        """Ramp down and end; each further call ramps down at the slew limit. Called from a signal handler."""
        self._stops_requested += 1
        if self._channel.session is not None and self._channel.connected:
            self._channel.session.stop()
        if self._stops_requested == 1:
            loop.call_soon_threadsafe(self._notifier.stopping)
            loop.call_soon_threadsafe(self._wake.set)

    async def _run_sessions(self) -> None:
        """Run sessions; start again after a failed start and after a reload.

        A wrong file ends the first start only: later a program may be writing it, and the daemon waits.
        """
        attempt, again, is_first = 0, True, True
        while again and not self._stops_requested:
            again, session = False, self._channel.session
            try:
                session = session or self._launch()
                await self._run_session(session)
                attempt = 0
            except PiezodError as error:
                is_half_written = isinstance(error, ConfigurationError) and not is_first
                waits = not self._arm and self._on_rows is None
                if not waits or self._channel.connected or not (isinstance(error, TemporaryError) or is_half_written):
                    raise
                await self._wait_to_retry(error, RETRY_S[min(attempt, len(RETRY_S) - 1)])
                attempt, again = attempt + 1, True
            finally:
                self._channel.close()
                if session is not None:
                    session.close()
            is_first = False
            again = again or self._next is not None

    def _launch(self) -> Session:
        """Start a control process with the configuration that a reload has set, or with the present one."""
        bench = self._next or self._bench
        folder = self._path.parent
        task = Task(bench, None, folder, (), self._path, self.outcome.heat_W)
        session = Session(task, self._lock, correction_size=correction_size(bench, folder))
        session.launch()
        self._bench, self._next, self._files = bench, None, ""
        self._launched.set()
        return session

    async def _wait_to_retry(self, error: PiezodError, pause_s: float) -> None:
        """Wait, disarmed. No control process ticks now, so the daemon itself feeds the watchdog of systemd."""
        if self._channel.problem != str(error):
            log_line(f"{error}; trying again")
        self._channel.problem = str(error)
        self._notifier.ready()
        self._notifier.status(f"DISARMED, {error}; trying again")
        deadline_s = clock.monotonic() + pause_s
        while (left_s := deadline_s - clock.monotonic()) > 0 and not self._wake.is_set():
            self._notifier.alive()
            await self._look_after_files(None)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), min(left_s, 0.5))
        self._wake.clear()

    async def _run_session(self, session: Session) -> None:
        channel = self._channel
        channel.open(session)
        try:
            kind, content = await self._wait_until_ready(session)
            if kind != "ready":
                return
            session.open_ring_log()
            self._files = content.files
            channel.connected, channel.problem = True, ""
            if self._recorder is not None:
                self._recorder.follow(self._bench.ring_log_path)
            self.statistics.begin()
            self.phase_watch.begin(session.shared.phases)
            if self._on_rows is None:
                self.model_watch.begin(self._bench, session.shared.correction)
            self._notifier.ready()
            self._notifier.status(f"DISARMED, {content.description}")
            if self._stops_requested:
                session.stop()
            arms = self._arm and not self._stops_requested
            arming = asyncio.get_running_loop().create_task(self._arm_at_start(session)) if arms else None
            if arming is None and self._on_rows is None:
                log_line(
                    f"{self._bench.name}: {self._bench.rate_Hz:g} Hz, reading only; arm with: piezod arm {self._path}"
                )
            await self._follow(session)
            if arming is not None:
                await arming
        finally:
            channel.stop_receiving()
            await self.model_watch.end()

    async def _wait_until_ready(self, session: Session) -> tuple[str, Any]:
        """Wait for the first message of the control process; a stop during this time ends it without an error."""
        begun_s = clock.monotonic()
        while not self._channel.has_message:
            if clock.monotonic() - begun_s < CONNECTED_WITHIN_S:
                self._notifier.starting()
            if self._stops_requested:
                session.stop()
            await self._look_after_files(session)
            await asyncio.sleep(POLL_INTERVAL_S / 10)
        kind, content = self._channel.next_message()
        if kind == "error" and not self._stops_requested:
            raise rebuild_error(*content)
        return kind, content

    def _urge(self, name: str) -> str:
        """Pass `stop` or `disarm` to the control process; one that starts will not arm. Safe in every thread."""
        self._arm_withdrawn = True
        if self._on_rows is not None:
            self._stops_requested += 1
        text = self._channel.urge(name)
        if self._on_rows is not None and not self._channel.connected:
            return "the drive will not begin"
        return "the start will not arm any more" if self._arm and not self._channel.connected else text

    async def _arm_at_start(self, session: Session) -> None:
        """Arm once, or end if a stop has come before; a stop after this look is later than the request."""
        requested_ns = clock.monotonic_ns()
        if self._arm_withdrawn:
            log_line(f"{self._bench.name}: a stop came before the arm; ending")
            session.stop()
            return
        try:
            await self._command("arm", requested_ns=requested_ns)
        except PiezodError:
            session.stop()
            raise
        log_line(f"{self._bench.name}: {self._bench.rate_Hz:g} Hz, armed")

    async def _follow(self, session: Session) -> None:
        """Read the ring log until the control process ends."""
        begun_s = clock.monotonic()
        while not self._channel.has_message:
            await self._look_after_files(session)
            is_starting = self.statistics.last is None and clock.monotonic() - begun_s < READY_WITHIN_S
            if self._read_rows(session) or is_starting:
                self._notifier.alive()
            if self._arm and self.statistics.was_driving and self.statistics.state in (State.DISARMED, State.FAULT):
                session.stop()
                self._arm = False
            if self._recorder is not None:
                self._recorder.log_change()
            await asyncio.sleep(POLL_INTERVAL_S)
        self._read_rows(session)
        kind, content = self._channel.next_message()
        if kind == "error":
            raise rebuild_error(*content)
        self.outcome = content

    async def _look_after_files(self, session: Session | None) -> None:
        """Restore removed files, if the last look was `FILES_INTERVAL_S` ago; also while no device is connected."""
        if clock.monotonic() > self._files_seen_s + FILES_INTERVAL_S:
            self._files_seen_s = clock.monotonic()
            await self._restore_files(session)

    async def _restore_files(self, session: Session | None) -> None:
        """Make lock, sockets and ring log again if somebody has removed them. No step prevents another one.

        Once another program has the bench, its files stand there: the service ends and makes none.
        """
        made, problems = [], []
        for name, restore in (
            ("lock", self._restore_lock),
            ("socket", lambda _: self._control_socket.restore()),
            ("stop socket", self._restore_stop_path),
            ("ring log", self._restore_ring_log),
        ):
            try:
                made += [name] if await restore(session) else []
            except PiezodError as error:
                problems.append(str(error))
            if self._lock_lost:
                return
        problem = "; ".join(problems)
        if problem and problem != self._files_problem:
            log_line(f"a file of the daemon was removed and cannot be made again: {problem}")
        self._files_problem = problem
        if made:
            log_line(f"somebody has removed the {', the '.join(made)} of the daemon; made again")

    async def _restore_lock(self, session: Session | None) -> bool:
        """Lock again; end if another program has the bench."""
        if not self._lock.restore():
            log_line(f"{self._bench.name}: its lock was removed, and another program has taken it; ramping down")
            self._lock_lost = True
            self._stops_requested += 1
            self._wake.set()
            if session is not None:
                session.stop()
        return False

    async def _restore_stop_path(self, _: Session | None) -> bool:
        """Listen for a stop again; ramp down, and again if armed, while nobody can stop the bench."""
        try:
            return self._stop_path.restore()
        finally:
            if self._stop_path.is_present or self._control_socket.is_present:
                self._stoppable_s = clock.monotonic()
            elif clock.monotonic() > self._stoppable_s + UNSTOPPABLE_S and self.statistics.state in DRIVING:
                log_line(f"{self._bench.name}: no socket can be made on which a stop would come; ramping down")
                self._urge("disarm")

    async def _restore_ring_log(self, session: Session | None) -> bool:
        """Let the control process make the ring log again, and read that one."""
        if session is None or self._on_rows is not None or not session.ring_log_is_broken:
            return False
        await self._command("ring log")
        session.open_ring_log()
        self.statistics.skip_lost_rows()
        if self._recorder is not None:
            self._recorder.follow(self._bench.ring_log_path)
        return True

    def _read_rows(self, session: Session) -> bool:
        """Evaluate the new rows of the ring log; return whether there were any."""
        dropped = session.dropped
        rows = session.read()
        if session.dropped != dropped:
            self.statistics.skip_lost_rows()
        self.statistics.add(rows)
        self.model_watch.add(rows)
        self.railed_watch.add(rows, self._bench)
        self.phase_watch.add_new(self._bench.daemon.slow_phase_ms)
        if self._on_rows is not None:
            self._on_rows(rows)
        return bool(rows.size)

    def _log_transition(self, state: State, cause: Cause, row: np.void) -> None:
        text = f"{state.name}: {CAUSE_TEXT[cause]}"
        log_line(f"{text} (force {row['force_N']:.2f} N, voltage {row['voltage_V']:.2f} V)")
        self._notifier.status(text)

    async def _command(self, name: str, argument: object = None, requested_ns: int | None = None) -> str:
        return await self._channel.send(name, argument, settle_s=2 * self._bench.dt_s, requested_ns=requested_ns)

    async def _answer(self, command: str, peer: Peer) -> dict[str, object]:
        """Execute one command of the socket."""
        if command in URGENT:
            text = self._urge(command)  # before the pipe, which may be full of other commands
            if self._on_rows is not None or (self._arm and not self._channel.connected):
                log_line(f"socket: {command} by {peer}: {text}")
                return {"ok": True, "message": text}
        if command == "status":
            return {"ok": True, **self.status()}
        if command == "log":
            return {"ok": True, "lines": list(JOURNAL.recent)}
        if command not in COMMANDS:
            return {"ok": False, "error": f"command is {command!r}, must be one of {', '.join(COMMANDS)}", "code": 2}
        try:
            if self._on_rows is not None:
                raise TemporaryError(f"{command}: a command drives this bench; wait for its end, or piezod stop")
            message = await (self._reload() if command == "reload" else self._command(command))
        except PiezodError as error:
            log_line(f"socket: {command} by {peer}: refused: {error}")
            return {"ok": False, "error": str(error), "code": error.exit_code}
        log_line(f"socket: {command} by {peer}: {message}")
        return {"ok": True, "message": message}

    async def _reload_on_signal(self) -> None:
        """Reload after SIGHUP."""
        self._notifier.reloading()
        try:
            log_line(f"reload: {await self._reload()}")
        except PiezodError as error:
            log_line(f"reload refused, the old configuration stays: {error}")
            self._notifier.status(f"reload refused: {error}")
        finally:
            self._notifier.ready()

    async def _reload(self) -> str:
        """Apply the configuration file as far as the state of the bench permits (`daemon/reload.py`).

        The answer comes when no control process with the former configuration can drive any more.
        """
        if self._reload_lock.locked():
            raise TemporaryError("reload: another reload is being executed; nothing was changed, try again")
        async with self._reload_lock:
            read = await read_bench_files(self._path)
            bench, files = read.bench, read.digest
            old, channel = self._bench, self._channel
            check_restart_keys(old, bench)
            if channel.session is None:
                self._bench = bench
                self._wake.set()
                return "configuration taken; the next connection uses it"
            check_settled(connected=channel.connected, ended=channel.ended, problem=channel.problem)
            if bench == old and files == self._files:
                return "nothing has changed"
            if self.status()["state"] == State.DISARMED.name and not self._arm:
                return await self._start_again(bench)
            check_armed_change(old, bench, self.statistics.state, is_other_file=files != self._files)
            answer = await self._command("limits", bench.limits)
            self._bench = bench
            return answer

    async def _start_again(self, bench: BenchConfig) -> str:
        """End the control process, which is disarmed, and wait for the launch of the next one."""
        self._next = bench
        self._launched.clear()
        try:
            await self._command("end")
        except PiezodError:
            self._next = None
            raise
        await self._launched.wait()
        return "configuration taken; starting again, disarmed"


def _ignore_signals() -> None:
    """Ignore signals from now on: the bench is at rest, and an event loop that closes cannot take them any more."""
    asyncio.get_running_loop().remove_signal_handler(signal.SIGHUP)
    for number in HANDLED:
        signals.handle(number, signal.SIG_IGN)
