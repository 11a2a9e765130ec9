"""Descriptors of the simulated machine: sockets, pipes, `poll` and selectors.

A number from `FIRST` on is a simulated object; a smaller one is a file of the real file system, in the folder of the
history. A local stream or pipe delivers at once. A TCP connection goes through a wire that may delay, lose, split,
double, garble or cut.
"""

import contextlib
import errno
import io
import os
import select
import selectors
import socket
import struct

from tests.simulation.machine import Hang

FIRST = 1_000_000
PIPE_BYTES = 65_536
MOST_AT_ONCE = 20_000  # waits in a row that end at once: no loop of piezod does so much without a pause
LOOPBACK = "127.0.0.1"


class Object:
    """A simulated object with a descriptor; `waiting` threads run again when its state changes."""

    def __init__(self, kernel, process):
        self.kernel, self.machine = kernel, kernel.machine
        kernel.last_descriptor += 1
        self.descriptor = kernel.last_descriptor
        kernel.objects[self.descriptor] = self
        self.owners = []
        self.waiting = {}
        self.open = True
        if process is not None:
            self.own(process)

    def own(self, process):
        self.owners.append(process)
        process.owned.append(self)

    def closed_by(self, process):
        """One process closes it; the last one closes it for all."""
        if process in self.owners:
            self.owners.remove(process)
            process.owned.remove(self)
        if not self.owners and self.open:
            self.open = False
            self.kernel.objects.pop(self.descriptor, None)
            self.shut()
            self.changed()

    def changed(self):
        for thread in list(self.waiting):
            thread.wake()

    def shut(self):
        """What the last close does."""

    def readable(self):
        return False

    def writable(self):
        return True


class Stream(Object):
    """One end of a byte stream."""

    def __init__(self, kernel, process):
        super().__init__(kernel, process)
        self.inbox = bytearray()
        self.peer = None
        self.ended = self.was_reset = self.connecting = False
        self.error = 0  # of a connection that was not made
        self.route = None  # sends bytes on their way; None: at once

    def readable(self):
        return bool(self.inbox) or self.ended or self.was_reset

    def writable(self):
        if self.connecting:
            return False
        if self.peer is None or not self.peer.open:
            return True  # a write then fails at once
        return self.was_reset or self.error or len(self.peer.inbox) < PIPE_BYTES

    def arrive(self, data):
        if self.open:
            self.inbox += data
            self.changed()

    def end(self):
        self.ended = True
        self.changed()

    def reset(self):
        self.was_reset = True
        self.changed()

    def send(self, data):
        if self.was_reset:
            raise ConnectionResetError(errno.ECONNRESET, os.strerror(errno.ECONNRESET))
        if self.route is not None:
            self.route(bytes(data))
            return len(data)
        if self.peer is None or not self.peer.open:
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))
        room = PIPE_BYTES - len(self.peer.inbox)
        if room <= 0:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        data = bytes(data[:room])
        self.peer.arrive(data)
        return len(data)

    def receive(self, size, *, peek=False):
        if self.inbox:
            data = bytes(self.inbox[:size])
            if not peek:
                del self.inbox[:size]
                if self.peer is not None:
                    self.peer.changed()
            return data
        if self.was_reset:
            raise ConnectionResetError(errno.ECONNRESET, os.strerror(errno.ECONNRESET))
        if self.ended:
            return b""
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    def shut(self):
        if self.route is not None:
            self.route(None)
        elif self.peer is not None and self.peer.open:
            self.peer.end()


class Listener(Object):
    """A socket that accepts streams."""

    def __init__(self, kernel, process):
        super().__init__(kernel, process)
        self.backlog, self.most = [], 0

    def readable(self):
        return bool(self.backlog)

    def shut(self):
        for stream in self.backlog:
            stream.owners.clear()
            stream.open = False
            self.kernel.objects.pop(stream.descriptor, None)
            stream.peer.reset()
        self.kernel.forget(self)


class Queue(Object):
    """A socket that receives datagrams."""

    MOST = 200

    def __init__(self, kernel, process):
        super().__init__(kernel, process)
        self.datagrams = []

    def readable(self):
        return bool(self.datagrams)

    def arrive(self, data):
        if self.open and len(self.datagrams) < self.MOST:
            self.datagrams.append(bytes(data))
            self.changed()

    def shut(self):
        self.kernel.forget(self)


class ProcessEnd(Object):
    """A descriptor of a process; readable after its end."""

    def __init__(self, kernel, process, target):
        super().__init__(kernel, process)
        self.target = target
        target.watchers.append(self.changed)

    def readable(self):
        return not self.target.alive


class Kernel:
    """Tables of descriptors and addresses."""

    def __init__(self, machine):
        self.machine = machine
        self.last_descriptor = FIRST
        self.objects = {}
        self.paths, self.ports, self.hosts = {}, {}, {}
        self.disk = None
        self.line = None  # the serial line, where there is one
        machine.close_real = self._close_real

    def forget(self, listener):
        for table in (self.paths, self.ports):
            for key in [key for key, value in table.items() if value is listener]:
                del table[key]

    def wait(self, ready, watched, until_ns):
        """Wait until `ready()` is true; its last value."""
        machine = self.machine
        machine.at_once += 1
        if machine.at_once > MOST_AT_ONCE:
            raise Hang(f"{machine.process.name}/{machine.current.name} asks again and again, and does nothing")
        while not (found := ready()):
            if until_ns is not None and machine.now_ns >= until_ns:
                return found
            thread = machine.current
            for one in watched:
                one.waiting[thread] = None
            machine.park(until_ns)
            for one in watched:
                one.waiting.pop(thread, None)
        return found

    def deadline_ns(self, timeout_s):
        now_ns = self.machine.look_ns()
        return None if timeout_s is None or timeout_s < 0 else now_ns + round(1e9 * timeout_s)

    # descriptors --------------------------------------------------------------------------------------------------

    def open_file(self, path, flags, mode=0o777):
        if str(path).endswith(".sqlite"):
            self.disk.create(flags)
        descriptor = os.open(path, flags, mode)
        self.machine.process.real.add(descriptor)
        return descriptor

    def _close_real(self, process):
        for descriptor in process.real:
            with contextlib.suppress(OSError):
                os.close(descriptor)
        process.real.clear()

    def close(self, descriptor):
        if descriptor >= FIRST:
            found = self.objects.get(descriptor)
            if found is None or self.machine.process not in found.owners:
                raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            found.closed_by(self.machine.process)
            return
        self.machine.process.real.discard(descriptor)
        os.close(descriptor)

    def read(self, descriptor, size):
        if descriptor < FIRST:
            return os.read(descriptor, size)
        found = self.objects[descriptor]
        self.wait(found.readable, [found], None)
        return found.receive(size)

    def open_serial_port(self, port, *arguments, **settings):
        return self.line.open_port(port, *arguments, **settings)

    def readv(self, descriptor, buffers):
        """Read into one buffer, without waiting."""
        data = self.objects[descriptor].receive(len(buffers[0]))
        buffers[0][: len(data)] = data
        return len(data)

    def write(self, descriptor, data):
        if descriptor in (1, 2):
            process = self.machine.process
            while process.log_fault == "stands":  # the pipe is full, and nobody reads it
                self.machine.park(self.machine.now_ns + 10_000_000)
            if process.log_fault == "gone":
                raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))
            for line in bytes(data).decode("utf-8", "replace").splitlines():
                self.machine.process.log.append(line)
                self.machine.note("log", self.machine.process.name, line)
            return len(data)
        if descriptor < FIRST:
            return os.write(descriptor, data)
        return self.objects[descriptor].send(data)

    def pipe(self):
        reader, writer = self.pair(self.machine.process)
        return reader.descriptor, writer.descriptor

    def set_blocking(self, descriptor, blocking):
        if descriptor < FIRST:
            os.set_blocking(descriptor, blocking)

    def pair(self, process):
        first, second = Stream(self, process), Stream(self, process)
        first.peer, second.peer = second, first
        return first, second

    # sockets ------------------------------------------------------------------------------------------------------

    def socket(self, family=socket.AF_INET, kind=socket.SOCK_STREAM, *_):
        return Socket(self, family, kind)

    def getaddrinfo(self, host, port, *_, **__):
        if host not in (LOOPBACK, "localhost"):
            raise socket.gaierror(socket.EAI_NONAME, "unknown host")
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (LOOPBACK, port))]

    def poll(self):
        return Poll(self)

    def select(self, read, write, _exceptional, timeout_s=None):
        watched = [self.objects[number_of(one)] for one in read]
        ready = self.wait(
            lambda: [one for one, found in zip(read, watched, strict=True) if found.readable()],
            watched, self.deadline_ns(timeout_s),
        )  # fmt: skip
        return ready, [], []

    def selector(self):
        return Selector(self)


def number_of(descriptor):
    return descriptor if isinstance(descriptor, int) else descriptor.fileno()


class Poll:
    """As `select.poll`, for simulated descriptors."""

    def __init__(self, kernel):
        self._kernel, self._watched = kernel, {}

    def register(self, descriptor, mask=select.POLLIN):
        self._watched[number_of(descriptor)] = mask

    def unregister(self, descriptor):
        del self._watched[number_of(descriptor)]

    def _ready(self):
        found = []
        for descriptor, mask in self._watched.items():
            one = self._kernel.objects.get(descriptor)
            if one is None:
                found.append((descriptor, select.POLLNVAL))
                continue
            events = (mask & select.POLLIN if one.readable() else 0) | (mask & select.POLLOUT if one.writable() else 0)
            if events:
                found.append((descriptor, events))
        return found

    def poll(self, timeout_ms=None):
        if timeout_ms is not None and timeout_ms <= 0:
            return self._ready()
        objects = self._kernel.objects
        watched = [objects[one] for one in self._watched if one in objects]
        return self._kernel.wait(
            self._ready, watched, self._kernel.deadline_ns(None if timeout_ms is None else 1e-3 * timeout_ms)
        )


class Selector(selectors._BaseSelectorImpl):
    """As `selectors.DefaultSelector`; `wake` ends a wait from another thread."""

    def __init__(self, kernel):
        super().__init__()
        self._kernel = kernel
        self._bell = Object(kernel, kernel.machine.process)
        self._rung = False

    def wake(self):
        self._rung = True
        self._bell.changed()

    def _ready(self):
        found = []
        objects = self._kernel.objects
        for key in self._fd_to_key.values():
            one = objects.get(key.fd)
            if one is None:
                continue
            events = (key.events & selectors.EVENT_READ if one.readable() else 0) | (
                key.events & selectors.EVENT_WRITE if one.writable() else 0
            )
            if events:
                found.append((key, events))
        return found or (["bell"] if self._rung else [])

    def select(self, timeout=None):
        if timeout is not None and timeout <= 0:
            found = self._ready()
        else:
            objects = self._kernel.objects
            watched = [objects[fd] for fd in self._fd_to_key if fd in objects] + [self._bell]
            found = self._kernel.wait(self._ready, watched, self._kernel.deadline_ns(timeout))
        self._rung = False
        return [one for one in found if one != "bell"]


class Socket(socket.socket):
    """As `socket.socket`, as far as piezod and asyncio use it; no socket of the system is opened."""

    family = type = proto = None  # the names are properties of the base

    def __init__(self, kernel, family, kind, found=None):
        self._kernel = kernel
        self.family, self.type, self.proto = family, socket.SocketKind(kind & 0xF), 0
        self._timeout_s = None
        self._peer_pid = 0
        self._address = ("", 0)
        if found is None:
            made = Queue if self.type is socket.SOCK_DGRAM else Stream
            found = made(kernel, kernel.machine.process)
        self._object = found

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def __repr__(self):
        return f"<socket {self.fileno()}>"

    def fileno(self):
        return self._object.descriptor if self._object.open else -1

    def close(self):
        machine = self._kernel.machine
        if machine.current is not None:
            self._object.closed_by(machine.process)

    def setblocking(self, blocking):
        self._timeout_s = None if blocking else 0.0

    def settimeout(self, timeout_s):
        self._timeout_s = timeout_s

    def gettimeout(self):
        return self._timeout_s

    def setsockopt(self, level, option, value, *_):
        if option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO) and isinstance(value, bytes):
            seconds, micro = struct.unpack("@ll", value)
            self._timeout_s = seconds + 1e-6 * micro

    def getsockopt(self, level, option, size=0):
        if option == socket.SO_ERROR:
            return self._object.error
        if option == socket.SO_PEERCRED:
            return struct.pack("3i", self._peer_pid, os.getuid(), os.getgid())
        return 0

    def getsockname(self):
        return self._address if self.family == socket.AF_INET else str(self._address)

    def getpeername(self):
        return self.getsockname()

    def bind(self, address):
        if self.family == socket.AF_UNIX:
            with socket.socket(socket.AF_UNIX, self.type) as real:  # leaves its file, which programs look at
                real.bind(address)
            status = os.lstat(address)
            self._listening(self._kernel.paths, (status.st_dev, status.st_ino))
        else:
            if (self.type, address[1]) in self._kernel.ports:
                raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
            self._listening(self._kernel.ports, (self.type, address[1]))
        self._address = address

    def _listening(self, table, key):
        if self.type is socket.SOCK_STREAM:
            process = self._kernel.machine.process
            self._object.closed_by(process)
            self._object = Listener(self._kernel, process)
        table[key] = self._object

    def listen(self, backlog=128):
        self._object.most = backlog

    def accept(self):
        listener = self._object
        self._until(listener.readable, listener)
        if not listener.backlog:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        stream = listener.backlog.pop(0)
        listener.changed()  # who waits for a place in the queue
        client = stream.peer.owners[0].pid if stream.peer.owners else 0
        process = self._kernel.machine.process
        stream.own(process)
        stream.owners.remove(listener)
        found = Socket(self._kernel, self.family, self.type, stream)
        found._peer_pid = client
        return found, ""

    def connect(self, address):
        kernel = self._kernel
        if self.type is socket.SOCK_DGRAM and self.family == socket.AF_INET:
            self._address = (LOOPBACK, 9)
            return
        listener = self._listener_at(address)
        if listener is not None:
            if isinstance(listener, Queue) != (self.type is socket.SOCK_DGRAM):
                raise OSError(errno.EPROTOTYPE, os.strerror(errno.EPROTOTYPE))
            if isinstance(listener, Queue):
                self._target = listener
                return
            if len(listener.backlog) > listener.most:
                if self._timeout_s == 0.0:
                    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
                self._until(lambda: len(listener.backlog) <= listener.most or not listener.open, listener)
            far = Stream(kernel, None)
            far.owners.append(listener)
            far.peer, self._object.peer = self._object, far
            listener.backlog.append(far)
            listener.changed()
            return
        host = kernel.hosts.get(address[1])
        if host is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
        host.connect(self, self._object)
        if self._timeout_s == 0.0:
            raise BlockingIOError(errno.EINPROGRESS, os.strerror(errno.EINPROGRESS))

    def _listener_at(self, address):
        """Who listens on this machine; None for a TCP address of the network.

        Raises
        ------
        OSError
            There is no such path, or nobody listens there.
        """
        if self.family != socket.AF_UNIX:
            return self._kernel.ports.get((self.type, address[1]))
        status = os.lstat(address)
        listener = self._kernel.paths.get((status.st_dev, status.st_ino))
        if listener is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
        return listener

    def _until(self, ready, *watched):
        """Wait as long as the time limit of the socket allows."""
        if self._timeout_s == 0.0 or ready():
            return
        if not self._kernel.wait(ready, watched, self._kernel.deadline_ns(self._timeout_s)):
            raise TimeoutError("timed out")

    def send(self, data, *_):
        self._until(self._object.writable, self._object)
        return self._object.send(data)

    def sendall(self, data):
        rest = bytes(data)
        while rest:
            rest = rest[self.send(rest) :]

    def sendto(self, data, address):
        kernel = self._kernel
        if self.family == socket.AF_UNIX:
            status = os.lstat(address)
            target = kernel.paths.get((status.st_dev, status.st_ino))
        else:
            target = kernel.ports.get((self.type, address[1]))
        if target is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
        target.arrive(data)
        return len(data)

    def recv(self, size, flags=0):
        self._until(self._object.readable, self._object)
        if isinstance(self._object, Queue):
            return self._datagram()[:size]
        return self._object.receive(size, peek=bool(flags & socket.MSG_PEEK))

    def _datagram(self):
        if not self._object.datagrams:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        return self._object.datagrams.pop(0)

    def recv_into(self, buffer, *_):
        data = self.recv(len(buffer))
        size = min(len(data), len(buffer))
        memoryview(buffer)[:size] = data[:size]
        return size

    def shutdown(self, _how):
        if isinstance(self._object, Stream) and self._object.peer is not None and self._object.peer.open:
            self._object.peer.end()

    def makefile(self, _mode):
        return Lines(self)


class Lines(io.RawIOBase):
    """The lines that arrive at a socket."""

    def __init__(self, owner):
        super().__init__()
        self._owner, self._rest = owner, b""

    def readline(self, _size=-1):
        while b"\n" not in self._rest:
            data = self._owner.recv(65536)
            if not data:
                line, self._rest = self._rest, b""
                return line
            self._rest += data
        line, end, self._rest = self._rest.partition(b"\n")
        return line + end
