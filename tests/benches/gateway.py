"""A serial gateway: carries bytes between TCP clients, one at a time, and a serial port, and can cut the connection."""

import contextlib
import os
import select
import socket
import termios
import threading
import tty

PIECE = 4096
WAIT_S = 0.02


class Gateway:
    """Serves `port` (a path) on 127.0.0.1; the number is `tcp_port`. `change_next` changes the next reply, once."""

    def __init__(self, port):
        self._serial = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        with contextlib.suppress(termios.error):
            tty.setraw(self._serial)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.tcp_port = self._listener.getsockname()[1]
        self.connections = 0
        self.change_next = None
        self._cut, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(5)
        self._listener.close()
        os.close(self._serial)

    def cut(self):
        """Close the present connection."""
        self._cut.set()

    def _serve(self):
        while not self._stop.is_set():
            if not select.select([self._listener], [], [], WAIT_S)[0]:
                continue
            client, _ = self._listener.accept()
            self.connections += 1
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._cut.clear()
            with client, contextlib.suppress(OSError):
                self._carry(client)

    def _carry(self, client):
        while not (self._stop.is_set() or self._cut.is_set()):
            readable, _, _ = select.select([client, self._serial], [], [], WAIT_S)
            if client in readable:
                data = client.recv(PIECE)
                if not data:
                    return
                os.write(self._serial, data)
            if self._serial in readable:
                data = os.read(self._serial, PIECE)
                change, self.change_next = self.change_next, None
                client.sendall(data if change is None else change(data))
