"""The server of the live page, on the loopback address: an ordinary process beside the daemon.

It reads shared memory and asks the daemon's parent over its socket; the control process knows nothing of it. Viewers
share one reader. What a viewer has not taken yet is not sent again: its next update waits until the last one went out.
"""

import asyncio
import errno
import logging
import os
import signal
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.core.templates import get_env
from bokeh.document import Document
from bokeh.models.widgets import Div
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop

from piezod.config import BenchConfig
from piezod.errors import BusyError, ConfigurationError, PiezodError
from piezod.report.live.feed import BUCKET_s, Feed
from piezod.report.live.template import LIVE_SCRIPT, LIVE_STYLE, TEMPLATE
from piezod.report.live.viewer import Viewer, add_desk

ADDRESS = "127.0.0.1"  # from elsewhere: ssh -L
LOOK_EVERY_s, ASK_EVERY_s = 0.1, 1.0
MOST_VIEWERS = 16
NICENESS = 10
SHORTEST_TOKEN = 16
LARGEST_MESSAGE_BYTES = 65536  # a viewer sends clicks and zooms

Ask = Callable[[str], dict[str, Any]]


def read_token(path: Path) -> str:
    """Read the token from a file that nobody else may read.

    Raises
    ------
    ConfigurationError
        The file cannot be read, is open to others, or holds fewer than 16 signs.
    """
    try:
        mode, token = path.stat().st_mode, path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(
            f"{path}: no token can be read: {getattr(error, 'strerror', None) or error}"
        ) from error
    if mode & 0o077:
        raise ConfigurationError(f"{path}: mode is {mode & 0o777:04o}, must be 0600 or less: chmod 600 {path}")
    if len(token) < SHORTEST_TOKEN:
        raise ConfigurationError(f"{path}: the token has {len(token)} signs, must have at least {SHORTEST_TOKEN}")
    return token


def serve_live_page(bench: BenchConfig, ask: Ask, port: int, token: str | None, say: Callable[[str], None]) -> None:
    """Serve until SIGINT or SIGTERM.

    Parameters
    ----------
    bench
        Whose ring log is shown.
    ask
        Sends one command to the daemon and returns its answer; raises `PiezodError`.
    port
        On the loopback address; 0 takes a free one.
    token
        Whoever types it may command; None: read only.
    say
        Called with the address.

    Raises
    ------
    BusyError
        The port is taken.
    """
    asyncio.run(_Page(bench, ask, token).serve(port, say))


class _Page:
    def __init__(self, bench: BenchConfig, ask: Ask, token: str | None) -> None:
        self._bench, self._ask, self._token = bench, ask, token
        self._feed = Feed(bench)
        self._asking = ThreadPoolExecutor(1, "ask")
        self._sending = ThreadPoolExecutor(1, "send")

    async def serve(self, port: int, say: Callable[[str], None]) -> None:
        """Listen, and follow the ring until told to end."""
        os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
        over = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, over.set)
        server, port = self._listen(port)
        server.start()
        logging.getLogger("bokeh").setLevel(logging.ERROR)  # a viewer that left is no news
        mode = "read only" if self._token is None else "commands with the token"
        say(f"live page: http://{ADDRESS}:{port}/  ({mode}; ends with Ctrl-C)")
        tasks = [loop.create_task(self._look()), loop.create_task(self._inquire())]
        await over.wait()
        for task in tasks:
            task.cancel()
        server.stop(wait=False)
        for pool in (self._asking, self._sending):
            pool.shutdown(wait=False, cancel_futures=True)

    def _listen(self, port: int) -> tuple[BaseServer, int]:
        """Bind; pages of other origins may not open a connection."""
        try:
            sockets, port = bind_sockets(ADDRESS, port)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise BusyError(f"--port is {port}, {ADDRESS}:{port} is taken; name another, or 0") from error
        pages = BokehTornado(
            Application(FunctionHandler(self._show)),
            extra_websocket_origins=[f"{ADDRESS}:{port}", f"localhost:{port}"],
            unused_session_lifetime_milliseconds=5000,
            check_unused_sessions_milliseconds=2000,
            websocket_max_message_size_bytes=LARGEST_MESSAGE_BYTES,
        )
        http = HTTPServer(pages)
        http.add_sockets(sockets)
        server = BaseServer(IOLoop.current(), pages, http)
        self._server = server
        return server, port

    def _show(self, document: Document) -> None:
        """Make one viewer's page."""
        document.template_variables.update(
            bench=self._bench.name,
            style=LIVE_STYLE,
            script=LIVE_SCRIPT,
            desk=self._token is not None,
            bucket_ms=round(1000 * BUCKET_s),
        )
        if len(self._server.get_sessions()) > MOST_VIEWERS:
            document.add_root(Div(text=f"{MOST_VIEWERS} viewers look at this bench already; close one and reload."))
            return
        document.template = get_env().from_string(TEMPLATE)
        document.config.notify_connection_status = False  # the page says it in its own words
        Viewer(document, self._feed)
        if self._token is not None:
            add_desk(document, self._token, self._command)

    async def _look(self) -> None:
        while True:
            self._feed.look()
            await asyncio.sleep(LOOK_EVERY_s)

    async def _inquire(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                self._feed.answered(await loop.run_in_executor(self._asking, self._ask, "status"), "")
            except PiezodError as error:
                self._feed.answered(None, str(error))
            await asyncio.sleep(ASK_EVERY_s)

    async def _command(self, name: str) -> str:
        """Send one command of a viewer who knows the token."""
        loop = asyncio.get_running_loop()
        try:
            answer = await loop.run_in_executor(self._sending, self._ask, name)
        except PiezodError as error:
            return f"{name}: refused: {error}"
        return f"{name}: {answer['message']}"
