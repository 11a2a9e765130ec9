"""Server of the live page: a separate process, on the loopback address.

It reads the ring log in shared memory, and requests the status from the daemon's socket once a second. It does not
involve the control process. All viewers share one reader. A slow viewer receives fewer updates.
"""

import asyncio
import errno
import logging
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.core.templates import get_env
from bokeh.document import Document
from bokeh.models.widgets import Div
from bokeh.server.server import BaseServer
from bokeh.server.util import bind_sockets
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop

from piezod.config import BenchConfig
from piezod.config.host_name import LOCAL_NAMES
from piezod.config.regular_file import open_regular
from piezod.errors import BusyError, ConfigurationError, PiezodError
from piezod.report.live.feed import Feed, SEGMENT_s
from piezod.report.live.protection import ProtectedPages
from piezod.report.live.template import LIVE_CSS, LIVE_SCRIPT, TEMPLATE
from piezod.report.live.viewer import Viewer, add_command_buttons

ADDRESS = "127.0.0.1"  # another machine reaches it through ssh -L
READ_EVERY_s, STATUS_EVERY_s = 0.1, 1.0
MOST_VIEWERS = 16
NICENESS = 10
SHORTEST_TOKEN = 16
LARGEST_MESSAGE_BYTES = 65536  # a viewer sends only clicks and zooms

SendCommand = Callable[[str], dict[str, Any]]


def read_token(path: Path) -> str:
    """Read the token from a file that only its owner can access.

    Raises
    ------
    ConfigurationError
        The file cannot be read, other users can access it, or the token has fewer than 16 characters.
    """
    try:
        with open_regular(path, LARGEST_MESSAGE_BYTES) as file:
            mode, token = os.fstat(file.fileno()).st_mode, file.read().decode().strip()
    except (OSError, UnicodeDecodeError, ConfigurationError) as error:
        raise ConfigurationError(f"no token can be read: {error}") from error
    if mode & 0o077:
        raise ConfigurationError(f"{path}: mode is {mode & 0o777:04o}, must be 0600 or less: chmod 600 {path}")
    if len(token) < SHORTEST_TOKEN:
        raise ConfigurationError(f"{path}: the token has {len(token)} characters, must have at least {SHORTEST_TOKEN}")
    return token


def serve_live_page(
    bench: BenchConfig,
    send_command: SendCommand,
    port: int,
    token: str | None,
    announce: Callable[[str], None],
    hosts: Sequence[str] = (),
) -> None:
    """Serve the live page until SIGINT or SIGTERM.

    Parameters
    ----------
    bench
        Configuration of the bench whose ring log is shown.
    send_command
        Sends one command to the daemon and returns its answer; raises `PiezodError`.
    port
        Port on the loopback address, 0 to 65535; 0 selects a free port.
    token
        Token that a viewer must type to send commands; None: the page is read only.
    announce
        Called once with a line that contains the address.
    hosts
        Host names under which the page may be opened besides 127.0.0.1 and localhost, such as the name of a proxy.

    Raises
    ------
    BusyError
        The port is in use.
    """
    asyncio.run(_Server(bench, send_command, token, hosts).serve(port, announce))


class _Server:
    def __init__(self, bench: BenchConfig, send_command: SendCommand, token: str | None, hosts: Sequence[str]) -> None:
        self._bench, self._send_command, self._token, self._hosts = bench, send_command, token, hosts
        self._feed = Feed(bench)
        self._status_thread = ThreadPoolExecutor(1, "status")
        self._command_thread = ThreadPoolExecutor(1, "command")

    async def serve(self, port: int, announce: Callable[[str], None]) -> None:
        """Serve viewers and read the ring log until a signal arrives."""
        os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
        end = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, end.set)
        server, port = self._bind(port)
        server.start()
        logging.getLogger("bokeh").setLevel(logging.ERROR)  # Bokeh warns about every viewer that leaves
        mode = "read only" if self._token is None else "commands with the token"
        announce(f"live page: http://{ADDRESS}:{port}/  ({mode}; ends with Ctrl-C)")
        tasks = [loop.create_task(self._read_rows()), loop.create_task(self._read_status())]
        await end.wait()
        for task in tasks:
            task.cancel()
        server.stop(wait=False)
        for pool in (self._status_thread, self._command_thread):
            pool.shutdown(wait=False, cancel_futures=True)

    def _bind(self, port: int) -> tuple[BaseServer, int]:
        """Bind the port. Other host names and pages of other origins are refused."""
        try:
            sockets, port = bind_sockets(ADDRESS, port)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise BusyError(f"--port is {port}, {ADDRESS}:{port} is taken; name another, or 0") from error
        pages = ProtectedPages(
            Application(FunctionHandler(self._show)),
            (*LOCAL_NAMES, *self._hosts),
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
        """Build the page of one viewer."""
        document.template_variables.update(
            bench=self._bench.name,
            style=LIVE_CSS,
            script=LIVE_SCRIPT,
            commands=self._token is not None,
            segment_ms=round(1000 * SEGMENT_s),
        )
        if len(self._server.get_sessions()) > MOST_VIEWERS:
            document.add_root(Div(text=f"{MOST_VIEWERS} viewers are already connected; close one and reload."))
            return
        document.template = get_env().from_string(TEMPLATE)
        document.config.notify_connection_status = False  # the template shows a warning of its own
        Viewer(document, self._feed)
        if self._token is not None:
            add_command_buttons(document, self._token, self._command)

    async def _read_rows(self) -> None:
        while True:
            self._feed.update()
            await asyncio.sleep(READ_EVERY_s)

    async def _read_status(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                status = await loop.run_in_executor(self._status_thread, self._send_command, "status")
                self._feed.set_status(status, "")
            except PiezodError as error:
                self._feed.set_status(None, str(error))
            await asyncio.sleep(STATUS_EVERY_s)

    async def _command(self, name: str) -> str:
        """Send a command of a viewer who typed the token."""
        loop = asyncio.get_running_loop()
        try:
            answer = await loop.run_in_executor(self._command_thread, self._send_command, name)
        except PiezodError as error:
            return f"{name}: refused: {error}"
        return f"{name}: {answer['message']}"
