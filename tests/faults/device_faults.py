"""Faults of the device beyond its wire: another device, lost settings, the load cell of a pair, heat.

The bench has a manually stepped clock. Faults of the same kind with real processes are steps in `running_faults.py`.
"""

from piezod.config import load_bench
from piezod.control import ControlLoop, State
from piezod.transport.modbus import ModbusLink
from piezod.transport.pair import PairLink
from tests.contract.judged_bench import FaultyWire
from tests.faults.manual_clock_bench import BENCH, ManualClockBench
from tests.faults.manual_clock_faults import _manual_clock_bench, _observe

IDENTITY_AT = 9  # first byte of register 0 in a reply that begins there


class OtherWire(FaultyWire):
    """A wire whose device can be exchanged for one with another identity."""

    other = False

    def take(self, reply, request):
        if self.other and request.reply_size == IDENTITY_AT + 8:
            reply = reply[:IDENTITY_AT] + b"\0\7" + reply[IDENTITY_AT + 2 :]
        return super().take(reply, request)


class PairBench(ManualClockBench):
    """Amplifier and load cell on two wires; the amplifier has no watchdog, as the profiles with a serial line."""

    def __init__(self):
        super().__init__(limits={"device_watchdog_ms": 0})
        bench = load_bench(BENCH)
        self.config = bench.model_copy(
            update={"limits": self.limits, "arming": bench.arming.model_copy(update={"without": ("device_watchdog",)})}
        )
        self.cell_wire = OtherWire(self.device, self.clock, timeout_ms=3)
        no_counter = {"command_echo": None, "command_sequence": None}
        map_ = bench.link.registers
        amplifier = map_.model_copy(update=no_counter | {"force": None, "heartbeat": None})
        cell = map_.model_copy(update=no_counter | {"voltage_setpoint": None, "voltage_readback": None, "status": None})
        links = [
            ModbusLink(bench.link.model_copy(update={"heartbeat_within_s": 10.0, "registers": registers}), wire)
            for registers, wire in ((amplifier, self.wire), (cell, self.cell_wire))
        ]
        self.link = PairLink(*links)
        self.loop = ControlLoop(
            self.link, self.limits, self.clock, self._ring, 1e-3, 400.0,
            sign_check=bench.arming.sign_check, readback_within_V=bench.arming.readback_within_V,
        )  # fmt: skip
        self.link.poll()


def loop_pair(pool, fault, *, how, most_ms=2500):
    """Lose the load cell of a pair, or let another device answer in its place after a reconnection."""
    bench = PairBench()
    try:
        bench.arm()
        if how == "lost":
            bench.cell_wire.up = False
        else:
            bench.cell_wire.other = True
            bench.cell_wire.connected = False
        observed = _observe(bench, fault, most_ms=most_ms)
        bench.run(200)  # the amplifier settles
        observed.figures["output_V"] = abs(bench.amplifier.output_V)
        return observed
    finally:
        bench.close()


def loop_heat(pool, fault, *, power_max_W, most_ms=8000):
    """Follow a reference that heats the stack above a low limit."""
    with _manual_clock_bench(limits={"dissipation_max_W": power_max_W}) as bench:
        bench.arm()
        before = bench.state is State.RUNNING
        observed = _observe(bench, fault, most_ms=most_ms)
        observed.figures["ran_before"] = float(before)
        return observed


INJECTORS = {"loop_pair": loop_pair, "loop_heat": loop_heat}
