"""Puts the simulated machine behind `piezod/runtime/`, for the rest of this process."""

import asyncio
import contextlib

from piezod.config import run_time_files
from piezod.daemon import journal
from piezod.runtime import chance, clock, databases, descriptors, processes, serial_ports, signals, sockets, threads
from piezod.session import control_process
from tests.simulation.event_loop import SimPolicy
from tests.simulation.spawning import SimCondition, SimThread


def install(machine, kernel, spawning, folder):
    """Replace every name of the door; there is no way back."""
    clock.monotonic = clock.process_time = lambda: 1e-9 * machine.look_ns()
    clock.monotonic_ns = clock.boot_ns = clock.perf_counter_ns = machine.look_ns
    clock.wall_ns = lambda: machine.look_ns() + machine.wall_offset_ns
    clock.wall_s = lambda: 1e-9 * clock.wall_ns()
    clock.sleep = machine.sleep
    sockets.socket, sockets.getaddrinfo = kernel.socket, kernel.getaddrinfo
    sockets.poll, sockets.select, sockets.DefaultSelector = kernel.poll, kernel.select, kernel.selector
    for name in ("open_file", "close", "read", "readv", "write", "pipe", "set_blocking"):
        setattr(descriptors, name, getattr(kernel, name))
    descriptors.fsync, databases.connect = kernel.disk.fsync, kernel.disk.connect
    serial_ports.open_port = kernel.open_serial_port
    for name in ("number", "pid_descriptor", "send_signal", "passed_descriptor", "end_with_parent", "start_module"):
        setattr(processes, name, getattr(spawning, name))
    processes.spawn_context, signals.handle = spawning.context, spawning.handle
    SimThread.machine = SimCondition.machine = machine
    threads.Thread, threads.Condition = SimThread, SimCondition
    chance.below = lambda limit: int(machine.chance.random() * limit)
    chance.token = lambda size: f"{machine.chance.getrandbits(8 * size):0{2 * size}x}"
    asyncio.set_event_loop_policy(SimPolicy(kernel, spawning))
    run_time_files.SERVICE = run_time_files.LOGIN = folder / "none"
    run_time_files.SHARED = folder / "locks"
    run_time_files.SHARED.mkdir()
    # a process of its own has its rights, its size and its journal: here several share this one
    control_process.real_time = lambda _: contextlib.nullcontext()
    control_process._resident_kib = lambda: 0


def new_process_of_the_daemon():
    """What a new process finds: a journal without lines and without a thread."""
    journal.JOURNAL.__init__()
