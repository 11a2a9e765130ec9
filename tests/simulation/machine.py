"""The simulated machine: one clock, and processes of which one runs at a time.

A thread of a process is a greenlet. It runs until it waits in a call of `piezod/runtime/`; then the next event of the
heap decides who runs. Nothing else takes turns, so the order depends on the seed only. Each look at the clock takes
`LOOK_NS`: a loop that never waits still ends at its deadline.
"""

import asyncio
import hashlib
import heapq
import random
import signal

from greenlet import getcurrent, greenlet

SECOND = 1_000_000_000
BOOTED_NS = 1000 * SECOND  # so that no program sees a time near zero
LOOK_NS = 300
CLOCK_TICKS_WALL_NS = 1_800_000_000 * SECOND


class Hang(AssertionError):  # noqa: N818  # the name of what happened
    """A history does not end."""


class Thread:
    """One thread of a process."""

    def __init__(self, process, target, name):
        self.process, self.name = process, name
        self.parked = self.done = False
        self.turn = 0  # number of the wait: an event of an earlier one is void
        self.joining = []
        self.greenlet = greenlet(self._run, process.machine.hub)
        self._target = target
        process.threads.append(self)
        process.machine.resume(self, 0)

    def _run(self):
        process = self.process
        try:
            self._target()
        except SystemExit as end:
            if process.threads[0] is self:
                process.exit(end.code if isinstance(end.code, int) else int(end.code is not None))
        except BaseException as error:  # noqa: BLE001  # the history shows it
            process.machine.failed(self, error)
            if process.threads[0] is self:
                process.exit(1)
        else:
            if process.threads[0] is self:
                process.exit(0)
        self.done = True
        for thread in self.joining:
            thread.wake()
        process.machine.hub.switch()

    def wake(self):
        """Let a waiting thread run again, after the latency of its process."""
        if self.parked:
            self.process.machine.resume(self, self.process.latency_ns())


class Process:
    """A process: threads, handlers of signals, descriptors."""

    def __init__(self, machine, name, parent=None):
        self.machine, self.name, self.parent = machine, name, parent
        machine.last_pid += 1
        self.pid, self.started_ns = machine.last_pid, machine.now_ns
        self.threads, self.pending = [], []
        self.handlers, self.received = {}, set()
        self.alive, self.code, self.stopped_until_ns = True, None, 0
        self.dies_with_parent = None
        self.owned, self.real = [], set()  # simulated objects, and descriptors of real files
        self.watchers = []  # called at the end
        self.log = []
        self.log_fault = ""  # of the reader of its log: it stands, or is gone
        machine.processes.append(self)

    def start(self, target):
        return Thread(self, target, "main")

    def latency_ns(self):
        """Time from an event to the thread that waits for it."""
        return self.machine.latency_ns()

    def signal(self, number):
        """Deliver a signal."""
        if not self.alive:
            raise ProcessLookupError
        self.machine.note("signal", self.name, int(number))
        self.received.add(int(number))
        if number == signal.SIGKILL:
            self.end(-int(number))
        elif number == signal.SIGSTOP:
            self.stopped_until_ns = 1 << 62
        elif number == signal.SIGCONT:
            self.stopped_until_ns = 0
        else:
            handler = self.handlers.get(int(number), signal.SIG_DFL)
            if handler == signal.SIG_IGN:
                return
            if handler == signal.SIG_DFL:
                self.end(-int(number))
                return
            self.pending.append(int(number))
            self.threads[0].wake()

    def run_handlers(self):
        """Run the handlers of the signals that have come, in the main thread."""
        while self.pending:
            number = self.pending.pop(0)
            handler = self.handlers.get(number)
            if callable(handler):
                handler(number, None)

    def exit(self, code):
        self.end(code)

    def end(self, code):
        """End now, without another instruction: sockets and files close, locks are released."""
        if not self.alive:
            return
        machine = self.machine
        self.alive, self.code = False, code
        machine.note("end", self.name, code)
        for owned in list(self.owned):
            owned.closed_by(self)
        machine.close_real(self)
        for child in list(machine.processes):
            if child.parent is self and child.alive and child.dies_with_parent:
                child.signal(child.dies_with_parent)
                if child.alive:  # the kernel may send it once for each thread of the parent
                    child.signal(child.dies_with_parent)
        for watch in self.watchers:
            watch()
        machine.graves.extend(self.threads)  # a greenlet that is collected would run its `finally`
        if machine.current is not None and machine.current.process is self:
            machine.hub.switch()


class Machine:
    """Clock, heap of events, and processes.

    Parameters
    ----------
    seed
        Seed of everything that is drawn.
    """

    def __init__(self, seed):
        self.now_ns = BOOTED_NS
        self.wall_offset_ns = CLOCK_TICKS_WALL_NS
        self.random = random.Random(seed)
        self.chance = random.Random(seed ^ 0x5EED)  # of the program itself
        self.hub = getcurrent()
        self.heap, self.sequence = [], 0
        self.processes, self.graves, self.last_pid = [], [], 100
        self.current = None
        self.stalled_until_ns = 0
        self.least_latency_ns, self.spread_ns = 20_000, 30_000
        self.digest = hashlib.sha256()
        self.trace, self.folder = None, "FOLDER"
        self.failures = []
        self.close_real = lambda process: None
        self.events = self.at_once = 0

    # time ---------------------------------------------------------------------------------------------------------

    def look_ns(self):
        """The monotonic time, for a program that asks [ns]."""
        self.now_ns += LOOK_NS
        return self.now_ns

    def latency_ns(self):
        return self.least_latency_ns + int(self.random.random() ** 4 * self.spread_ns)

    def at(self, time_ns, call):
        """Call at a time, not before now."""
        self.sequence += 1
        heapq.heappush(self.heap, (time_ns, self.sequence, call))

    def after(self, delay_ns, call):
        self.at(self.now_ns + delay_ns, call)

    # threads ------------------------------------------------------------------------------------------------------

    def resume(self, thread, delay_ns):
        turn = thread.turn

        def run():
            if thread.turn != turn or not thread.process.alive or thread.done:
                return
            held_ns = max(self.stalled_until_ns, thread.process.stopped_until_ns)
            if held_ns > self.now_ns:
                self.at(min(held_ns, self.now_ns + 1_000_000) if held_ns >= 1 << 61 else held_ns, run)
                return
            thread.turn += 1
            thread.parked = False
            self.current = thread
            thread.greenlet.switch()
            self.current = None

        self.after(delay_ns, run)

    def park(self, until_ns=None):
        """Wait until the thread is woken, or until a time; handlers of signals run before this returns."""
        thread = self.current
        process = thread.process
        self.at_once = 0
        if process.pending and process.threads[0] is thread:
            process.run_handlers()
            return
        thread.parked = True
        if until_ns is not None:
            self.resume(thread, max(0, until_ns - self.now_ns) + process.latency_ns())
        loop = asyncio._get_running_loop()
        asyncio._set_running_loop(None)
        self.hub.switch()
        asyncio._set_running_loop(loop)
        if process.pending and process.threads[0] is thread:
            process.run_handlers()

    def sleep(self, duration_s):
        end_ns = self.look_ns() + round(1e9 * duration_s)
        while self.now_ns < end_ns:
            self.park(end_ns)

    def run(self, until_ns, most_events=50_000_000):
        """Run events until a time."""
        heap = self.heap
        while heap and heap[0][0] <= until_ns:
            time_ns, _, call = heapq.heappop(heap)
            self.now_ns = max(self.now_ns, time_ns)
            self.events += 1
            if self.events > most_events:
                raise Hang(f"{self.events} events at {self.time_s:.6f} s")
            call()
        self.now_ns = max(self.now_ns, until_ns)

    @property
    def time_s(self):
        """Virtual time since the start [s]."""
        return 1e-9 * (self.now_ns - BOOTED_NS)

    @property
    def process(self):
        """The process that runs."""
        return self.current.process

    # the history --------------------------------------------------------------------------------------------------

    def note(self, *what):
        """Add a fact to the history: its hash, and its trace."""
        line = f"{self.now_ns - BOOTED_NS} {' '.join(map(str, what))}".replace(self.folder, "FOLDER")
        self.digest.update(line.encode())
        if self.trace is not None:
            self.trace(line)

    def failed(self, thread, error):
        """A thread ended by an exception."""
        self.failures.append((thread.process.name, thread.name, error))
        self.note("exception", thread.process.name, thread.name, type(error).__name__, error)
