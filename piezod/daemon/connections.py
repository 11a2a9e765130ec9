"""The tasks that serve the clients of a server: started at a connection, ended with the server.

The end of the server never leaves a task behind. The event loop would cancel it at its own end and print a traceback
(Python 3.11).
"""

import asyncio
from collections.abc import Awaitable, Callable

TURNS = 4  # turns of the event loop from the acceptance of a connection to the call of `Connections.accept`, at most
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Connections:
    """Client callback of an asyncio server.

    Parameters
    ----------
    serve
        Serves one client until it is done or cancelled.
    """

    def __init__(self, serve: Serve) -> None:
        self._serve = serve
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False

    def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Start the task of a client."""
        if self._closed:
            writer.close()
            return
        task = asyncio.get_running_loop().create_task(self._run(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(lambda ended: self._end(ended, writer))

    async def _run(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await self._serve(reader, writer)

    def _end(self, task: asyncio.Task[None], writer: asyncio.StreamWriter) -> None:
        self._tasks.discard(task)
        writer.close()

    async def close(self, server: asyncio.Server) -> None:
        """Close a server, cancel the task of every client and wait for its end.

        Parameters
        ----------
        server
            Server that calls `accept`.
        """
        self._closed = True
        for listener in server.sockets:
            asyncio.get_running_loop().remove_reader(listener.fileno())
        for _ in range(TURNS):
            await asyncio.sleep(0)
        server.close()
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await asyncio.sleep(0)  # the event loop closes the sockets now
