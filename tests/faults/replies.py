"""Stale and forged replies against the links over a real socket and a real pseudo-terminal, and against bare pymodbus.

A reply counts as accepted when the exchange says OK, or when the force that nobody measured stands in the reading.
pymodbus' own synchronous clients are asked the same (function 23) beside it, without retries; they count as accepting
when they hand out registers.
"""

import contextlib
import logging
import time
from dataclasses import dataclass

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException

from piezod.transport import ACKNOWLEDGED, ExchangeResult, make_link
from tests.faults.forgeries import KINDS, MARK_N, ON_RTU, ON_TCP, forged
from tests.unit.transport.conftest import rtu_config, tcp_config
from tests.unit.transport.scripted import ScriptedPty, ScriptedTcp

TIMEOUT_S = 0.02
RECOVERS_WITHIN_S = 5.0
PYMODBUS_TIMES = 5  # it does the same every time
WIRES = {"tcp": (ScriptedTcp, tcp_config, ON_TCP), "rtu": (ScriptedPty, rtu_config, ON_RTU)}
HEADER = (
    f"{'kind':<18} {'what':<42} {'wire':<4} {'sent':>6} {'accepted':>8}  {'refused as':<34} "
    f"{'bare pymodbus accepts':>21}"
)  # fmt: skip


@dataclass
class Row:
    """One kind on one wire."""

    kind: str
    wire: str
    sent: int
    accepted: int
    refused_as: dict[str, int]
    pymodbus: int
    pymodbus_sent: int

    def text(self):
        refused = ", ".join(
            f"{name} {count}" for name, count in sorted(self.refused_as.items(), key=lambda one: -one[1])
        )
        return (
            f"{self.kind:<18} {KINDS[self.kind]:<42} {self.wire:<4} {self.sent:>6} {self.accepted:>8}  {refused:<34} "
            f"{self.pymodbus:>10} of {self.pymodbus_sent}"
        )


def rows(times, kinds=tuple(KINDS), show=None):
    """A row for each kind on each wire that has it, the kind sent so many times."""
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    for wire, (server_class, make_config, known) in WIRES.items():
        for kind in known:
            if kind not in kinds:
                continue
            with server_class() as server:
                accepted, refused_as = against_link(
                    server, make_config(server.port, timeout_s=TIMEOUT_S), kind, wire, times
                )
            with server_class() as server:
                tried = min(times, PYMODBUS_TIMES)
                row = Row(kind, wire, times, accepted, refused_as, against_pymodbus(server, kind, wire, tried), tried)
            if show is not None:
                show(row)
            yield row


class _Forger:
    """Lets a scripted device answer well, and badly when told to."""

    def __init__(self, server, kind, wire):
        self.server, self.kind, self.wire = server, kind, wire
        self.before, self.sent, self.armed = b"", 0, False
        server.answer = self.answer

    def answer(self, frame, _number):
        good = self.server.good(frame)
        before, self.before = self.before, good
        if not self.armed:
            return [good]
        self.armed = False
        self.sent += 1
        return [forged(self.kind, good, before, self.sent, framing=self.wire)]


def against_link(server, config, kind, wire, times):
    """How many were accepted, and what the others were refused as."""
    forger, accepted, refused_as = _Forger(server, kind, wire), 0, {}
    link = make_link(config)
    link.open()
    try:
        while forger.sent < times:
            k, before = forger.sent, forger.sent
            _until_good(lambda k=k: link.exchange(1.0 + k % 7))
            forger.armed = True
            result = link.exchange(2.0 + k % 5)
            forger.armed = False
            if forger.sent == before:  # the request came too late for a reply in time: once more
                continue
            if result is ExchangeResult.OK or link.reading.force_N == MARK_N:
                accepted += 1
            else:
                name = result.name.lower()
                refused_as[name] = refused_as.get(name, 0) + 1
                if kind != "stale_heartbeat":  # this one does answer the request, its reading alone is stale
                    accepted += result in ACKNOWLEDGED
    finally:
        link.close()
    return accepted, refused_as


def _until_good(act):
    """Repeat until the link is well again: after a doubtful reply it distrusts the line for a while."""
    end_s = time.monotonic() + RECOVERS_WITHIN_S
    while (result := act()) is not ExchangeResult.OK:
        assert time.monotonic() < end_s, f"the link does not recover: {result.name}"
        time.sleep(0.001)


def against_pymodbus(server, kind, wire, times):
    """How many pymodbus' own client takes for an answer."""
    forger, accepted = _Forger(server, kind, wire), 0
    for _ in range(times):
        client = (
            ModbusTcpClient("127.0.0.1", port=server.port, timeout=0.1, retries=0)
            if wire == "tcp"
            else ModbusSerialClient(server.port, baudrate=921600, timeout=0.1, retries=0)
        )
        client.connect()
        try:
            _ask(client)
            forger.armed = True
            answer = _ask(client)
            accepted += answer is not None and not answer.isError() and bool(answer.registers)
            forger.armed = False
        finally:
            client.close()
    return accepted


def _ask(client):
    with contextlib.suppress(ModbusException, OSError, IndexError, ValueError):
        return client.readwrite_registers(
            read_address=200, read_count=7, write_address=100, values=[0, 0, 1], device_id=1
        )
    return None


def summary(found):
    """Both counts."""
    kinds = {row.kind for row in found}
    taken = sorted({row.kind for row in found if row.pymodbus})
    sent, accepted = sum(row.sent for row in found), sum(row.accepted for row in found)
    return (
        f"{accepted} of {sent} stale or forged replies accepted, {len(kinds)} kinds; "
        f"bare pymodbus accepts {len(taken)} of them ({', '.join(taken)})"
    )
