"""One exchange, voltage out and reading back, against libmodbus and pymodbus on the same wire.

Everybody runs as the control process does: real-time priority, no deep sleep of the cores. Whether a core must be woken
decides more than what a client is, so the server is held on one core and every client on another. The rows "one core"
show what a client computes: there the two only take turns.
"""

import contextlib
import os
import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np

from piezod.commissioning.shipped_files import shipped
from piezod.config import RealTimeConfig, load_bench
from piezod.config.link import LinkConfig, ModbusRtuLink
from piezod.control import real_time
from piezod.errors import PiezodError
from piezod.transport import ExchangeResult, make_link
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.rounds import PERCENTILES, ROUNDS, Figures, alternate, percentiles
from tests.benchmarks.table import NotMeasuredError, Row

EXCHANGES = 1500  # a round; many short rounds, since the cost of a core's wake-up varies
SLOW_EXCHANGES = 100  # for the serial client of pymodbus, which takes milliseconds
SILENCE_NS = 20_000  # above the 3.5 characters that separate RTU frames; within a tick the loop is idle for longer
MOST_RATIO = {("libmodbus", "tcp"): 1.3, ("libmodbus", "rtu"): 1.3, ("pymodbus", "rtu"): 0.1}
SERVERS = {"minimal server": peers.minimal_server, "emulator": peers.emulator}
WIRES = {"tcp": "TCP", "rtu": "RTU on a pty"}
CASES = (  # wire, server, whether server and client share a core
    ("tcp", "minimal server", False),
    ("tcp", "emulator", False),
    ("rtu", "minimal server", False),
    ("rtu", "emulator", False),
    ("tcp", "minimal server", True),
)


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows of both wires and both servers."""
    count, rounds = (EXCHANGES // 5, ROUNDS) if quick else (EXCHANGES, 3 * ROUNDS)
    cores = sorted(os.sched_getaffinity(0))
    with in_real_time() as missing:
        for kind, server, one_core in CASES:
            what = f"{WIRES[kind]}, {server}" + (", one core" if one_core else "")
            client_core = cores[-1] if one_core else cores[0]
            try:
                with on_core(cores[-1]), SERVERS[server](kind) as address, on_core(client_core):
                    yield from _rows(what, address, count, rounds, missing, targets=not one_core)
            except (NotMeasuredError, PiezodError) as reason:
                yield Row("exchange", what, note=f"not measured: {reason}")


@contextlib.contextmanager
def in_real_time() -> Iterator[str]:
    """Give this process the priority and latency request of the control process; yields what is missing."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with real_time(RealTimeConfig(lock_memory=False)):
            yield "; ".join(str(one.message) for one in caught)


@contextlib.contextmanager
def on_core(core: int) -> Iterator[None]:
    """Restrict this process and its new children to one core."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _rows(what: str, address: peers.Address, count: int, rounds: int, note: str, *, targets: bool) -> Iterator[Row]:
    slow = SLOW_EXCHANGES * count // EXCHANGES if address.kind == "rtu" else count
    actions: dict[str, Callable[[], Figures]] = {
        "ours": lambda: ours_us(address, count),
        "pymodbus": lambda: peers.pymodbus_us(address, slow),
    }
    with contextlib.ExitStack() as stack:
        try:
            program = stack.enter_context(peers.libmodbus_client())
            actions["libmodbus"] = lambda: percentiles(peers.libmodbus_ns(program, address, count) * 1e-3)
        except NotMeasuredError as reason:
            note = f"libmodbus: not measured: {reason}; {note}"
        found = alternate(actions, rounds)
    for other in ("libmodbus", "pymodbus"):
        most_ratio = MOST_RATIO.get((other, address.kind)) if targets else None
        for k, q in enumerate(PERCENTILES if other in found else ()):
            figure, limit = float(found["ours"][k]), float(found[other][k])
            yield Row("exchange", f"{what}, p{q}", "us", figure, limit, other, most_ratio=most_ratio, note=note)


def ours_us(address: peers.Address, count: int) -> Figures:
    """Percentiles of this link's exchange [us].

    Raises
    ------
    NotMeasuredError
        An exchange failed.
    """
    link = make_link(link_config(address))
    took_ns = np.empty(count)
    link.open()
    try:
        for k in range(-count // 10, count):
            begun = _after_silence_ns() if address.kind == "rtu" else time.perf_counter_ns()
            result = link.exchange(0.0)
            took_ns[k] = time.perf_counter_ns() - begun
            if result != ExchangeResult.OK:
                raise NotMeasuredError(f"exchange {k} ended with {result.name}")
    finally:
        link.close()
    return percentiles(took_ns * 1e-3)


def _after_silence_ns() -> int:
    end_ns = time.perf_counter_ns() + SILENCE_NS
    while (now_ns := time.perf_counter_ns()) < end_ns:
        pass
    return now_ns


def link_config(address: peers.Address) -> LinkConfig:
    """The link of the shipped bench, to `address`."""
    link = load_bench(shipped("bench.yaml")).link
    if address.kind == "tcp":
        return link.model_copy(update={"host": address.host, "port": address.port})
    return ModbusRtuLink(
        kind="modbus_rtu",
        port=address.where,
        baudrate=peers.BAUDRATE,
        unit_id=peers.UNIT,
        timeout_s=0.1,
        registers=link.registers,
    )
