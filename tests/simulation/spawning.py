"""Processes, threads and pipes of the simulated machine, behind `piezod/runtime/processes.py` and `threads.py`."""

import asyncio
import ctypes
import errno
import io
import json
import os
import pickle
import signal

from tests.simulation.machine import Process, Thread
from tests.simulation.sockets import ProcessEnd

CODES = {"B": ctypes.c_ubyte, "q": ctypes.c_int64, "d": ctypes.c_double}
START_S = (0.15, 0.6)  # shortest time of a start, and what the load of the machine adds at most


class PassedDescriptor:
    """A descriptor on its way to a process that is being spawned."""

    def __init__(self, spawning, descriptor):
        self._spawning = spawning
        self._copy = os.dup(descriptor)

    def detach(self):
        self._spawning.machine.process.real.add(self._copy)
        return self._copy


class Connection:
    """As `multiprocessing.connection.Connection`: whole messages over a local stream."""

    def __init__(self, spawning, stream):
        self._spawning, self._stream = spawning, stream

    def fileno(self):
        return self._stream.descriptor

    def close(self):
        self._stream.closed_by(self._spawning.machine.process)

    def send(self, message):
        data = self._spawning.dumps(message)
        stream = self._stream
        if stream.peer is None or not stream.peer.open:
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))
        self._spawning.kernel.wait(stream.writable, [stream, stream.peer], None)
        stream.peer.arrive(len(data).to_bytes(8, "big") + data)

    def _complete(self):
        inbox = self._stream.inbox
        whole = len(inbox) >= 8 and len(inbox) >= 8 + int.from_bytes(inbox[:8], "big")
        return whole or self._stream.ended

    def poll(self, timeout=0.0):
        if timeout == 0.0:
            return self._complete()
        kernel = self._spawning.kernel
        return bool(kernel.wait(self._complete, [self._stream], kernel.deadline_ns(timeout)))

    def recv(self):
        self._spawning.kernel.wait(self._complete, [self._stream], None)
        inbox = self._stream.inbox
        if len(inbox) < 8:
            raise EOFError
        size = int.from_bytes(inbox[:8], "big")
        data = bytes(inbox[8 : 8 + size])
        del inbox[: 8 + size]
        self._stream.peer.changed()
        return self._spawning.loads(data)


class SpawnedProcess:
    """As `multiprocessing.Process`."""

    def __init__(self, spawning, target, args, name):
        self._spawning, self._target, self._name = spawning, target, name
        self._args = args
        self._process = None

    def start(self):
        spawning = self._spawning
        parent = spawning.machine.process
        content = spawning.dumps(self._args)
        process = Process(spawning.machine, self._name, parent)
        self._process = process
        for argument in self._args:
            if isinstance(argument, Connection):
                argument._stream.own(process)

        def run():
            spawning.machine.sleep(spawning.start_s())
            self._target(*spawning.loads(content))

        process.start(run)

    @property
    def pid(self):
        return self._process.pid

    @property
    def exitcode(self):
        return self._process.code

    def is_alive(self):
        return self._process.alive

    def join(self, timeout=None):
        kernel, process = self._spawning.kernel, self._process
        if process.alive:
            end = ProcessEnd(kernel, kernel.machine.process, process)
            kernel.wait(end.readable, [end], kernel.deadline_ns(timeout))
            end.closed_by(kernel.machine.process)

    def kill(self):
        if self._process.alive:
            self._process.signal(signal.SIGKILL)

    terminate = kill


class Spawning:
    """Starts processes; `start_module` starts those that the program names by their module."""

    def __init__(self, machine, kernel):
        self.machine, self.kernel = machine, kernel
        self.modules, self._shared = {}, {}

    def start_s(self):
        least_s, more_s = START_S
        return least_s + more_s * self.machine.random.random()

    # by reference: memory that processes share, and ends of pipes; everything else is copied

    def dumps(self, content):
        out, shared = io.BytesIO(), self._shared

        class Sharing(pickle.Pickler):
            def persistent_id(self, one):
                if isinstance(one, (ctypes.Array, Connection, PassedDescriptor)):
                    shared[id(one)] = one
                    return id(one)
                return None

        Sharing(out).dump(content)
        return out.getvalue()

    def loads(self, data):
        shared = self._shared

        class Sharing(pickle.Unpickler):
            def persistent_load(self, number):
                return shared[number]

        return Sharing(io.BytesIO(data)).load()

    # as the context of multiprocessing

    def context(self):
        return self

    def RawArray(self, code, size):
        return (CODES[code] * size)()

    def Pipe(self, duplex=True):
        first, second = self.kernel.pair(self.machine.process)
        return Connection(self, first), Connection(self, second)

    def Process(self, target, args=(), daemon=None):
        return SpawnedProcess(self, target, args, target.__name__.strip("_"))

    # as piezod.runtime.processes

    def number(self):
        return self.machine.process.pid

    def passed_descriptor(self, descriptor):
        return PassedDescriptor(self, descriptor)

    def pid_descriptor(self, pid):
        target = next(one for one in self.machine.processes if one.pid == pid)
        return ProcessEnd(self.kernel, self.machine.process, target).descriptor

    def send_signal(self, descriptor, number):
        found = self.kernel.objects.get(descriptor)
        if not isinstance(found, ProcessEnd):
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        found.target.signal(number)

    def end_with_parent(self, number):
        process = self.machine.process
        process.dies_with_parent = number
        return process.parent is None or process.parent.alive

    async def start_module(self, module, argument, longest_line):
        return Companion(self, module, argument, longest_line)

    # as piezod.runtime.signals

    def handle(self, number, handler):
        handlers = self.machine.process.handlers
        before = handlers.get(int(number), signal.SIG_DFL)
        handlers[int(number)] = handler
        return before


class Companion:
    """As `asyncio.subprocess.Process`, for a process with pipes for its input and output."""

    class Input:
        def __init__(self, stream):
            self._stream = stream

        def write(self, data):
            self._stream.send(data)

    def __init__(self, spawning, module, argument, longest_line):
        machine, kernel = spawning.machine, spawning.kernel
        parent = machine.process
        ours, theirs = kernel.pair(parent)
        back, out = kernel.pair(parent)
        self._process = process = Process(machine, module.rpartition(".")[2], parent)
        self._ends = (ours, back)
        for stream in (theirs, out):
            stream.own(process)
            stream.closed_by(parent)
        self.pid = process.pid
        self.stdin = self.Input(ours)
        loop = asyncio.get_running_loop()
        self.stdout = asyncio.StreamReader(limit=longest_line, loop=loop)
        self._ended = asyncio.Event()
        loop.add_reader(back.descriptor, self._read, loop, back)
        enter = spawning.modules[module]

        def run():
            machine.sleep(spawning.start_s())
            enter(json.loads(argument), theirs.descriptor, out.descriptor)

        process.start(run)

    def _read(self, loop, back):
        data = back.receive(READ_BYTES)
        if data:
            self.stdout.feed_data(data)
            return
        loop.remove_reader(back.descriptor)
        self.stdout.feed_eof()
        self._ended.set()
        for stream in self._ends:
            stream.closed_by(stream.owners[0]) if stream.owners else None

    async def wait(self):
        await self._ended.wait()
        while self._process.alive:  # noqa: ASYNC110  # its pipes close before it has ended
            await asyncio.sleep(0.001)
        return self._process.code

    def kill(self):
        if not self._process.alive:
            raise ProcessLookupError
        self._process.signal(signal.SIGKILL)


READ_BYTES = 65536


class SimThread:
    """As `threading.Thread`."""

    machine = kernel = None

    def __init__(self, target=None, args=(), name="thread", daemon=None, kwargs=None):
        self._target = lambda: target(*args, **(kwargs or {}))
        self._name = name
        self._thread = None

    def start(self):
        self._thread = Thread(self.machine.process, self._target, self._name)

    def is_alive(self):
        return self._thread is not None and not self._thread.done

    def join(self, timeout=None):
        machine, thread = self.machine, self._thread
        end_ns = None if timeout is None else machine.look_ns() + round(1e9 * timeout)
        while not thread.done and (end_ns is None or machine.now_ns < end_ns):
            thread.joining.append(machine.current)
            machine.park(end_ns)
            thread.joining.remove(machine.current)


class SimCondition:
    """As `threading.Condition`; only one thread runs at a time, so the lock is no more than a block."""

    machine = None

    def __init__(self):
        self._waiting = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def notify_all(self):
        for thread in list(self._waiting):
            thread.wake()

    def wait_for(self, predicate, timeout=None):
        machine = self.machine
        end_ns = None if timeout is None else machine.look_ns() + round(1e9 * timeout)
        while not (found := predicate()):
            if end_ns is not None and machine.now_ns >= end_ns:
                return found
            thread = machine.current
            self._waiting[thread] = None
            machine.park(end_ns)
            self._waiting.pop(thread, None)
        return found
