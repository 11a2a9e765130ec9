"""The daemon's connection to the present control process: its messages, and commands that wait for their answers."""

import asyncio
import contextlib
from typing import Any

from piezod.errors import TemporaryError
from piezod.runtime import clock
from piezod.session.session import Session, rebuild_error
from piezod.transport.bad_exchange import read_bad_exchange

ANSWER_WITHIN_S = 10.0
"""Longest time from the request of a command to its answer [s]; shorter than the patience of a client."""
AT_ONCE = ("disarm", "stop")  # commands that do not wait for the answer to another command


class CommandChannel:
    """Connection to one control process after the other; runs in the event loop of the daemon.

    Parameters
    ----------
    session
        First session, whose control process has been launched.

    Attributes
    ----------
    session
        Present session; None between two sessions.
    connected
        Whether the control process is connected to the device.
    ended
        Whether the control process of the present session has ended.
    problem
        Why the device is not connected; empty while it is connected or starts for the first time.
    """

    def __init__(self, session: Session) -> None:
        self.session: Session | None = session
        self.connected = self.ended = False
        self.problem = ""
        self._bad_exchange: dict[str, object] | None = None
        self._descriptor = -1
        self._messages: asyncio.Queue[tuple[str, Any]] = asyncio.Queue()
        self._answers: dict[int, asyncio.Future[tuple[str, str]]] = {}
        self._lock = asyncio.Lock()

    def urge(self, name: str) -> str:
        """Command `stop` or `disarm` by a signal, without waiting; safe in every thread.

        Parameters
        ----------
        name
            `stop` or `disarm`.

        Returns
        -------
        str
            Text of the answer.
        """
        session = self.session
        if session is None or not self.connected or not session.urge(name):
            return "no control process drives"
        return "passed to the control process"

    @property
    def counters(self) -> tuple[int, ...]:
        """Counters of the present control process in the ring log; empty without one."""
        return () if self.session is None else self.session.counters

    @property
    def bad_exchange(self) -> dict[str, object] | None:
        """Last failed exchange with the device in this or an earlier session; None: there was none."""
        if self.session is not None and (exchange := read_bad_exchange(self.session.shared.bad_exchange)) is not None:
            self._bad_exchange = exchange
        return self._bad_exchange

    def open(self, session: Session) -> None:
        """Receive the messages of a session from now on.

        Parameters
        ----------
        session
            Session whose control process has been launched.
        """
        self.session, self._messages, self._descriptor = session, asyncio.Queue(), session.descriptor
        self.ended = False
        asyncio.get_running_loop().add_reader(self._descriptor, self._receive, session, self._descriptor)

    def stop_receiving(self) -> None:
        """Receive no more messages of the session."""
        asyncio.get_running_loop().remove_reader(self._descriptor)

    def close(self) -> None:
        """Forget the session, but not its last failed exchange."""
        self._bad_exchange = self.bad_exchange
        self.session, self.connected = None, False

    @property
    def has_message(self) -> bool:
        """Whether `next_message` returns a message."""
        return not self._messages.empty()

    def next_message(self) -> tuple[str, Any]:
        """Return the next message other than an answer: `ready`, `done` or `error`, as in `Session.receive`.

        Raises
        ------
        asyncio.QueueEmpty
            There is no message.
        """
        return self._messages.get_nowait()

    async def send(
        self, name: str, argument: object = None, *, settle_s: float, requested_ns: int | None = None
    ) -> str:
        """Send a command and wait for its answer; one command at a time, except those of `AT_ONCE`.

        Parameters
        ----------
        name, argument
            Command of the control process (`session/command_queue.py`).
        settle_s
            Time to wait after the answer, so that the next status shows the effect of the command [s].
        requested_ns
            Monotonic time of the request, from which the command expires [ns]; None: now.

        Returns
        -------
        str
            Text of the answer.

        Raises
        ------
        PiezodError
            The command is refused, the device is not connected, or the control process does not answer.
        """
        requested_ns = clock.monotonic_ns() if requested_ns is None else requested_ns
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                async with contextlib.nullcontext() if name in AT_ONCE else self._lock:
                    kind, text = await self._ask(name, argument, requested_ns)
        except TimeoutError:
            raise TemporaryError(f"{name}: the control process did not answer; see piezod status") from None
        if kind != "ok":
            raise rebuild_error(kind, text)
        await asyncio.sleep(settle_s)
        return text

    async def _ask(self, name: str, argument: object, requested_ns: int) -> tuple[str, str]:
        """Send one command and return its answer; an `arm` whose answer does not come in time is taken back."""
        session = self.session
        if session is None or not self.connected:
            raise TemporaryError(f"{name}: the device is not connected: {self.problem or 'starting'}; try again")
        if self.ended:
            raise TemporaryError(f"{name}: the control process has ended; try again")
        number = session.command(name, argument, requested_ns)
        self._answers[number] = asyncio.get_running_loop().create_future()
        try:
            return await self._answers[number]
        except asyncio.CancelledError:
            if name == "arm":
                session.command("disarm")  # behind the `arm` in the pipe
            raise
        finally:
            del self._answers[number]

    def _receive(self, session: Session, descriptor: int) -> None:
        """Receive one message; called when the descriptor is readable."""
        kind, content = session.receive()
        if kind == "answer":
            number, *answer = content
            self._resolve(number, (answer[0], answer[1]))
            return
        if kind in ("done", "error"):
            self.ended = True
            asyncio.get_running_loop().remove_reader(descriptor)
            for number in list(self._answers):
                self._resolve(number, ("TemporaryError", "the control process has ended"))
        self._messages.put_nowait((kind, content))

    def _resolve(self, number: int, answer: tuple[str, str]) -> None:
        """Give an answer to the command that waits for it; discard an answer that is too late."""
        waiting = self._answers.get(number)
        if waiting is not None and not waiting.done():
            waiting.set_result(answer)
