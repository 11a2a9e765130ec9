"""The firmware: registers, command, watchdog and device clock.

Register map (big-endian words; of float32 and int32 the most significant word comes first):

- 0 identity 20570, 1 map version, 2-3 the number 1234.5, 4 serial number, 5 virtual time (0, 1)
- 100-101 set point [V], 102 command sequence
- 110 watchdog [ms], 112-113 virtual tick [us]
- 200-201 force [N], 202-203 voltage read back [V], 204 heartbeat, 205 command echo, 206 status
- 207-208 temperature [degC]
- 209-210 reference [N], 211 reference counter (both written by another master)

In real time, every request and a background task advance the physics to the present, in whole steps.

In virtual time, every write of the set point advances the physics by one tick, under the set point before it. A second
reading without a command in between also advances it by one tick. A client that only reads therefore sees time pass. A
read of the command echo alone is no reading: a client may check it at the end of a tick.
"""

import math
import struct
from collections.abc import Callable, Sequence
from typing import Literal

from firmware_sim.config import Firmware
from firmware_sim.errors import RefusedError
from firmware_sim.physics.bench import Bench, Sample

IDENTITY = 20570
MAP_VERSION = 1
ORDER_CHECK = 1234.5
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3

LONGEST_CATCH_UP_S = 1.0  # after a longer pause of the process, the time beyond this is dropped

_READABLE = ((0, 6), (100, 103), (110, 111), (112, 114), (200, 212))
_WRITABLE = ((100, 103), (110, 111), (112, 114), (209, 212))
_END = 212
_SHORTEST_TICK_US, _LONGEST_TICK_US = 10, 10_000_000


class Device:
    """The firmware of one bench.

    Parameters
    ----------
    time
        `real`: device time follows `now_ns`. `virtual`: it follows the writes of the set point.
    now_ns
        Monotonic clock [ns].
    """

    def __init__(
        self, bench: Bench, firmware: Firmware, time: Literal["real", "virtual"], now_ns: Callable[[], int]
    ) -> None:
        self.bench = bench
        self.virtual = time == "virtual"
        self._firmware = firmware
        self._now_ns = now_ns
        self._steps_per_ns = bench.clock_rate * 1e-9 / bench.step_s
        self._longest_steps = round(LONGEST_CATCH_UP_S / bench.step_s)
        self._start_ns = now_ns()
        self._done_steps = 0
        self._was_read = False
        self._words = [0] * _END
        self._words[0:6] = [
            IDENTITY,
            MAP_VERSION,
            *_words(">f", ORDER_CHECK),
            firmware.serial_number,
            int(self.virtual),
        ]
        self._words[112:114] = _words(">i", firmware.virtual_tick_us)
        bench.set_fault(firmware.fault_bits)
        self._set_watchdog(firmware.watchdog_ms)
        self._words[110] = firmware.watchdog_ms

    def catch_up(self) -> None:
        """Advance the physics to the present; does nothing in virtual time."""
        if self.virtual:
            return
        due = int((self._now_ns() - self._start_ns) * self._steps_per_ns)
        behind = due - self._done_steps
        if behind > self._longest_steps:
            self._done_steps += behind - self._longest_steps
            behind = self._longest_steps
        self.bench.advance_steps(behind)
        self._done_steps += behind

    def sample(self) -> Sample:
        """Return the present sample; in virtual time, a repeated reading first advances by one tick."""
        if self.virtual and self._was_read:
            self._pass_tick()
        self._was_read = True
        self.catch_up()
        return self.bench.sample()

    @property
    def command_echo(self) -> int:
        """Sequence number of the last command."""
        return self._words[102]

    @property
    def serial_number(self) -> int:
        """Serial number of the device."""
        return self._firmware.serial_number

    @property
    def watchdog_ms(self) -> int:
        """Timeout of the watchdog [ms]; 0: off."""
        return self._words[110]

    @staticmethod
    def check_readable(address: int, count: int) -> None:
        """Raise `RefusedError` with code 2 for an address outside the map."""
        _require(address, count, _READABLE)

    def read(self, address: int, count: int) -> list[int]:
        """Read registers.

        Raises
        ------
        RefusedError
            With code 2: an address outside the map.
        """
        _require(address, count, _READABLE)
        if (address, count) == (205, 1):
            self._words[205] = self._words[102]
        elif address + count > 200:
            self._refresh()
        return self._words[address : address + count]

    def write(self, address: int, values: Sequence[int]) -> None:
        """Write registers: all of them, or none.

        Raises
        ------
        RefusedError
            With code 2: an address outside the map, or read-only. With code 3: a value out of range.
        """
        _require(address, len(values), _WRITABLE)
        words = self._words.copy()
        words[address : address + len(values)] = values
        written = range(address, address + len(values))
        if 101 in written:
            self._check_voltage(_value(">f", words[100:102]))
        if 113 in written:
            _check_tick(int(_value(">i", words[112:114])))
        self._words = words
        if 110 in written:
            self._set_watchdog(words[110])
        if 101 in written:
            self._command(_value(">f", words[100:102]))
        elif 100 in written or 102 in written:
            self.catch_up()
            self.bench.feed_watchdog()

    def command(self, voltage_V: float) -> None:
        """Set the voltage [V] and increment the command sequence, for the line protocol.

        Raises
        ------
        RefusedError
            With code 3: the voltage is not finite, or out of range.
        """
        sequence = (self._words[102] + 1) & 0xFFFF
        self.write(100, [*_words(">f", voltage_V), sequence])

    def _command(self, voltage_V: float) -> None:
        if self.virtual:
            self._pass_tick()
            self._was_read = False
        else:
            self.catch_up()
        self.bench.set_voltage(voltage_V)

    def _pass_tick(self) -> None:
        self.bench.advance(1e-6 * _value(">i", self._words[112:114]))

    def _check_voltage(self, voltage_V: float) -> None:
        low_V, high_V = self.bench.scenario.amplifier.minimum_V, self.bench.scenario.amplifier.maximum_V
        if not (math.isfinite(voltage_V) and low_V <= voltage_V <= high_V):
            raise RefusedError(ILLEGAL_VALUE, f"set point is {voltage_V:g} V, must be {low_V:g} to {high_V:g}")

    def _set_watchdog(self, timeout_ms: int) -> None:
        firmware = self._firmware
        self.bench.set_watchdog(1e-3 * timeout_ms, safe_V=firmware.safe_V, ramp_V_per_s=firmware.watchdog_ramp_V_per_s)

    def _refresh(self) -> None:
        sample = self.sample()
        measured = struct.pack(
            ">ffHHHf",
            sample.force_N,
            sample.voltage_readback_V,
            sample.heartbeat,
            self._words[102],
            sample.status,
            sample.temperature_C,
        )
        self._words[200:209] = struct.unpack(">9H", measured)


def _require(address: int, count: int, regions: Sequence[tuple[int, int]]) -> None:
    for start, end in regions:
        if start <= address and address + count <= end:
            return
    raise RefusedError(ILLEGAL_ADDRESS, f"registers {address} to {address + count - 1} are not in the map")


def _check_tick(tick_us: int) -> None:
    if not _SHORTEST_TICK_US <= tick_us <= _LONGEST_TICK_US:
        raise RefusedError(
            ILLEGAL_VALUE, f"virtual tick is {tick_us} us, must be {_SHORTEST_TICK_US} to {_LONGEST_TICK_US}"
        )


def _words(layout: str, value: float) -> tuple[int, ...]:
    return struct.unpack(">2H", struct.pack(layout, value))


def _value(layout: str, words: Sequence[int]) -> float:
    value: float = struct.unpack(layout, struct.pack(">2H", *words))[0]
    return value
