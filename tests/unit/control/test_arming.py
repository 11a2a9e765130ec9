"""Preconditions of arming, each alone."""

from itertools import count, cycle
from pathlib import Path

import pytest

from piezod.config import load_bench
from piezod.control import check_ready
from piezod.errors import CheckFailedError, ConfigurationError, IdentityError
from piezod.transport import ExchangeResult, Reading
from tests.benches.in_process_link import InProcessLink

BENCH = load_bench(Path(__file__).parents[3] / "config" / "bench.yaml")
REGISTERS = {"watchdog_ms": 0.0, "heartbeat": 0.0}


class Rest:
    """Device at rest with a counting heartbeat."""

    def __init__(self, forces_N=(0.1, -0.1), readback_V=0.01, beats=None):
        self.forces_N, self.readback_V = cycle(forces_N), readback_V
        self.beats = count(1) if beats is None else cycle(beats)
        self.writes = []

    def exchange(self, voltage_V):
        if voltage_V is not None:
            self.writes.append(voltage_V)
        reading = Reading()
        reading.force_N, reading.voltage_readback_V = next(self.forces_N), self.readback_V
        reading.heartbeat = next(self.beats)
        return reading


def changed(section, **values):
    return BENCH.model_copy(update={section: getattr(BENCH, section).model_copy(update=values)})


def check(device, bench=BENCH, link=None):
    link = link or InProcessLink(device, REGISTERS)
    check_ready(bench, link, sleep=lambda _: None)
    assert device.writes == []
    return link


def test_a_device_at_rest_is_ready_and_its_watchdog_is_set():
    assert check(Rest()).read_register("watchdog_ms") == BENCH.limits.device_watchdog_ms


@pytest.mark.parametrize(
    ("device", "bench", "says"),
    [
        (Rest(forces_N=(0.0, 0.0, 50.0, 50.0)), BENCH, "must agree within 19 N"),
        (Rest(forces_N=(0.0, 0.0, 2.0)), changed("arming", agree_within_N=1.0), "must agree within 1 N"),
        (Rest(forces_N=(-25.0,)), BENCH, "force is -25 N at rest, must be within limits.force_min_N, -20"),
        (Rest(forces_N=(400.0,)), BENCH, "force is 400 N at rest"),
        (Rest(readback_V=2.1), BENCH, "reads back 2.1 V, must be within 2 V of 0 V"),
        (Rest(readback_V=0.0), changed("limits", voltage_min_V=20.0), "reads back 0 V, must be within 2 V of 20 V"),
        (Rest(readback_V=-20.0), changed("limits", voltage_min_V=20.0), "reads back -20 V, must be within 2 V of 20 V"),
        (Rest(readback_V=float("inf")), BENCH, "reads back inf V"),
        (Rest(beats=(7,)), BENCH, "heartbeat stays at 7"),
        (Rest(), changed("limits", device_watchdog_ms=0), "device_watchdog_ms is 0, must be above 0"),
    ],
)
def test_a_failed_precondition_is_named_and_no_voltage_is_written(device, bench, says):
    with pytest.raises(CheckFailedError, match=says):
        check(device, bench)
    assert device.writes == []


def test_a_range_above_zero_begins_at_its_lower_end():
    check(Rest(readback_V=20.5), changed("limits", voltage_min_V=20.0))


def test_a_watchdog_that_does_not_keep_its_time_is_refused():
    class Forgetful(InProcessLink):
        def write_register(self, role, value):
            pass

    link = Forgetful(Rest(), REGISTERS)
    with pytest.raises(CheckFailedError, match="watchdog reads back 0 ms after 100 ms were written"):
        check(link._device, link=link)


def test_a_device_that_refuses_its_watchdog_refuses_arming():
    with pytest.raises(ConfigurationError, match="watchdog_ms"):
        check(Rest(), link=InProcessLink(Rest(), {"heartbeat": 0.0}))


def test_a_device_that_gives_no_good_reading_is_named():
    class Silent:
        writes = ()

        def exchange(self, voltage_V):
            return ExchangeResult.TIMEOUT

    with pytest.raises(CheckFailedError, match="gives no good reading: timeout"):
        check(Silent())


def test_identity_is_compared_at_every_arming():
    class Other(InProcessLink):
        def identify(self):
            raise IdentityError("another device")

    link = Other(Rest(), REGISTERS)
    with pytest.raises(IdentityError):
        check(link._device, link=link)


@pytest.mark.parametrize("role", ["identity", "map_version", "voltage_readback"])
def test_a_role_missing_in_the_map_is_refused_unless_listed_in_arming_without(role):
    registers = BENCH.link.registers.model_copy(update={role: None})
    bench = BENCH.model_copy(update={"link": BENCH.link.model_copy(update={"registers": registers})})
    with pytest.raises(CheckFailedError, match=f"the link names no {role}"):
        check(Rest(), bench)
    check(Rest(), bench.model_copy(update={"arming": bench.arming.model_copy(update={"without": (role,)})}))
