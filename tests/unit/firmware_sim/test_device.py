import math
import struct

import numpy as np
import pytest

from firmware_sim.config import Firmware
from firmware_sim.errors import RefusedError
from firmware_sim.firmware.device import Device
from firmware_sim.physics.bench import Bench
from tests.unit.firmware_sim.waves import bench


class Clock:
    """A monotonic clock that the test moves."""

    def __init__(self):
        self.ns = 0

    def __call__(self):
        return self.ns

    def wait(self, duration_s):
        self.ns += round(1e9 * duration_s)


def words(layout, value):
    return list(struct.unpack(">2H", struct.pack(layout, value)))


def value(layout, registers):
    return struct.unpack(layout, struct.pack(f">{len(registers)}H", *registers))[0]


def real_device(**firmware):
    clock = Clock()
    return Device(bench(), Firmware(**firmware), "real", clock), clock


def virtual_device(seed=1, tick_us=1000):
    return Device(Bench("stack", seed=seed), Firmware(virtual_tick_us=tick_us), "virtual", Clock())


def exchange(device, voltage_V, sequence):
    device.write(100, [*words(">f", voltage_V), sequence])
    return struct.unpack(">ffHHHffH", struct.pack(">12H", *device.read(200, 12)))


def test_the_identity_block_names_the_device():
    device, _ = real_device(serial_number=77)
    assert device.read(0, 2) == [20570, 1]
    assert value(">f", device.read(2, 2)) == 1234.5
    assert device.read(4, 2) == [77, 0]
    assert virtual_device().read(5, 1) == [1]


@pytest.mark.parametrize(
    ("address", "count"), [(6, 1), (5, 2), (99, 2), (103, 1), (111, 1), (110, 3), (199, 1), (212, 1)]
)
def test_addresses_outside_the_map_are_refused_with_code_2(address, count):
    device, _ = real_device()
    with pytest.raises(RefusedError) as refusal:
        device.read(address, count)
    assert refusal.value.code == 2


@pytest.mark.parametrize("address", [0, 5, 200, 206, 208])
def test_read_only_registers_are_refused_with_code_2(address):
    device, _ = real_device()
    with pytest.raises(RefusedError) as refusal:
        device.write(address, [1])
    assert refusal.value.code == 2


@pytest.mark.parametrize("voltage_V", [math.nan, math.inf, -math.inf, -0.1, 140.1, 1e30])
def test_an_impossible_set_point_is_refused_with_code_3_and_not_written(voltage_V):
    device, _ = real_device()
    exchange(device, 25.0, 1)
    with pytest.raises(RefusedError) as refusal:
        device.write(100, [*words(">f", voltage_V), 2])
    assert refusal.value.code == 3
    assert value(">f", device.read(100, 2)) == 25.0
    assert device.read(102, 1) == [1]
    assert device.bench.command_V == 25.0


def test_a_set_point_written_by_halves_acts_with_its_low_word():
    device, _ = real_device()
    high, low = words(">f", 77.3)
    device.write(100, [high])
    assert device.bench.command_V == 0.0
    device.write(101, [low])
    assert device.bench.command_V == pytest.approx(77.3, rel=1e-6)


def test_the_reference_belongs_to_the_other_master():
    device, _ = real_device()
    device.write(209, [*words(">f", 123.25), 9])
    *_, reference_N, counter = exchange(device, 10.0, 1)
    assert (reference_N, counter) == (123.25, 9)


def test_real_time_follows_the_clock_in_whole_steps():
    device, clock = real_device()
    clock.wait(0.0500501)
    assert device.read(204, 1) == [200]
    assert device.bench.time_s == pytest.approx(0.05)
    clock.wait(0.00005)
    device.catch_up()
    assert device.bench.time_s == pytest.approx(0.0501)


def test_a_skewed_clock_makes_the_heartbeat_gain():
    clock = Clock()
    device = Device(bench(effects={"clock_skew": {"skew_ppm": 1000.0}}), Firmware(), "real", clock)
    for _ in range(10):
        clock.wait(0.9)
        device.catch_up()
    assert device.bench.time_s == pytest.approx(9.009, abs=2e-4)


def test_a_bench_that_was_stopped_for_long_does_not_make_up_for_it():
    device, clock = real_device()
    clock.wait(3600.0)
    device.catch_up()
    assert device.bench.time_s == pytest.approx(1.0)
    clock.wait(0.1)
    device.catch_up()
    assert device.bench.time_s == pytest.approx(1.1)


def test_written_now_and_read_now_shows_the_effect_of_the_command_before():
    for device in (virtual_device(), real_device()[0]):
        _, readback_V, *_ = exchange(device, 100.0, 1)
        assert abs(readback_V) < 0.1


def test_the_watchdog_ramps_the_output_to_its_safe_value_until_a_command_comes():
    device, clock = real_device(watchdog_ramp_V_per_s=200.0)
    device.write(110, [50])
    exchange(device, 100.0, 1)
    clock.wait(0.049)
    assert device.sample().status == 1
    clock.wait(0.251)
    device.catch_up()
    assert device.bench.output_V == pytest.approx(100.0 - 200.0 * 0.25, abs=0.1)
    assert device.sample().status == 1 | 2
    clock.wait(0.5)
    device.catch_up()
    assert device.bench.output_V == 0.0
    device.write(102, [2])  # no voltage: still tripped
    assert device.sample().status == 1 | 2
    exchange(device, 30.0, 3)
    clock.wait(0.01)
    assert device.sample().status == 1
    assert device.bench.output_V == 30.0


def test_without_a_watchdog_the_output_holds_for_ever():
    device, clock = real_device()
    exchange(device, 100.0, 1)
    for _ in range(20):
        clock.wait(1.0)
        device.catch_up()
    assert device.bench.output_V == 100.0
    assert device.sample().status == 1


def test_any_register_of_the_command_block_feeds_the_watchdog():
    device, clock = real_device(watchdog_ms=20)
    exchange(device, 100.0, 1)
    for sequence in range(10):
        clock.wait(0.015)
        device.write(102, [sequence])
    assert device.sample().status == 1


def test_virtual_time_passes_a_tick_a_command_whatever_else_is_asked():
    device = virtual_device()
    device.read(200, 12)
    device.read(0, 6)
    device.write(102, [5])
    assert device.bench.time_s == 0.0
    heartbeats = [exchange(device, 10.0, sequence)[2] for sequence in range(1, 6)]
    assert heartbeats == [4, 8, 12, 16, 20]


def test_virtual_time_passes_a_tick_a_reading_for_who_only_watches():
    device = virtual_device()
    exchange(device, 10.0, 1)
    heartbeats = [device.read(204, 1)[0] for _ in range(3)]
    assert heartbeats == [8, 12, 16]


def test_a_check_of_the_echo_takes_no_virtual_time():
    checked, unchecked = virtual_device(), virtual_device()
    for sequence in range(1, 6):
        readings = exchange(checked, 10.0 * sequence, sequence), exchange(unchecked, 10.0 * sequence, sequence)
        assert checked.read(205, 1) == [sequence]
        assert readings[0] == readings[1]


def test_the_virtual_tick_can_be_set_and_its_range_is_guarded():
    device = virtual_device()
    device.write(112, words(">i", 250))
    exchange(device, 10.0, 1)
    assert device.bench.time_s == pytest.approx(2e-4)  # what is left of the tick counts for the next
    exchange(device, 10.0, 2)
    assert device.bench.time_s == pytest.approx(5e-4)
    with pytest.raises(RefusedError) as refusal:
        device.write(112, words(">i", -5))
    assert refusal.value.code == 3


def test_virtual_time_is_reproducible_to_the_bit():
    drive_V = 70.0 + 60.0 * np.sin(np.arange(500) / 40.0)
    runs = []
    for seed in (3, 3, 4):
        device = virtual_device(seed)
        runs.append([exchange(device, voltage_V, k + 1) for k, voltage_V in enumerate(drive_V)])
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_a_fault_takes_the_output_away():
    device, clock = real_device(fault_bits=8)
    exchange(device, 50.0, 1)
    clock.wait(0.01)
    assert device.sample().status & 0b1001 == 8
    assert device.bench.output_V == 0.0
