"""Stale and false replies to the links over a socket and a pseudo-terminal, and to plain pymodbus clients.

A reply counts as accepted when the exchange result is OK, or when the reading holds the marked force. The synchronous
clients of pymodbus get the same replies (function 23, no retries). They accept a reply when they return registers.
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
PYMODBUS_TIMES = 5  # its result does not vary
WIRES = {"tcp": (ScriptedTcp, tcp_config, ON_TCP), "rtu": (ScriptedPty, rtu_config, ON_RTU)}
HEADER = (
    f"{'kind':<18} {'what':<42} {'wire':<4} {'sent':>6} {'accepted':>8}  {'refused as':<34} "
    f"{'plain pymodbus accepts':>22}"
)  # fmt: skip


@dataclass
class Row:
    """Result of one kind of reply on one wire."""

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
    """Yield a row for each kind on each wire where it exists, each sent `times` times."""
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
    """Makes a scripted device answer correctly, or with a false reply while `armed`."""

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
    """Number of accepted replies, and the counts of exchange results of the refused ones."""
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
            if forger.sent == before:  # the request came too late for a reply in time: repeat
                continue
            if result is ExchangeResult.OK or link.reading.force_N == MARK_N:
                accepted += 1
            else:
                name = result.name.lower()
                refused_as[name] = refused_as.get(name, 0) + 1
                if kind != "stale_heartbeat":  # a stale heartbeat acknowledges the command; only its reading is stale
                    accepted += result in ACKNOWLEDGED
    finally:
        link.close()
    return accepted, refused_as


def _until_good(act):
    """Repeat until an exchange is OK: after a false reply the link rejects the line for a time."""
    end_s = time.monotonic() + RECOVERS_WITHIN_S
    while (result := act()) is not ExchangeResult.OK:
        assert time.monotonic() < end_s, f"the link does not recover: {result.name}"
        time.sleep(0.001)


def against_pymodbus(server, kind, wire, times):
    """Number of replies that the client of pymodbus accepts."""
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
    """Counts of accepted replies, for the links and for pymodbus."""
    kinds = {row.kind for row in found}
    taken = sorted({row.kind for row in found if row.pymodbus})
    sent, accepted = sum(row.sent for row in found), sum(row.accepted for row in found)
    return (
        f"{accepted} of {sent} stale or false replies accepted, {len(kinds)} kinds; "
        f"plain pymodbus accepts {len(taken)} of them ({', '.join(taken)})"
    )
