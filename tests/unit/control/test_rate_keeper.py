"""Absolute deadlines: missed ticks are skipped and counted, never replayed."""

import time

import pytest

from piezod.control import RealRateKeeper


def test_a_missed_tick_is_skipped_and_counted_and_the_next_deadline_stays_on_the_grid():
    keeper = RealRateKeeper(0.01)
    keeper.start()
    begun_ns = keeper._deadline_ns
    time.sleep(0.035)
    keeper.wait()
    assert keeper.missed >= 3
    assert keeper.tick == keeper.missed + 1
    assert (keeper._deadline_ns - begun_ns) % 10_000_000 == 0
    assert keeper._deadline_ns - begun_ns == keeper.tick * 10_000_000
    keeper.wait()
    assert time.monotonic_ns() >= keeper._deadline_ns


def test_wait_never_returns_before_its_deadline():
    keeper = RealRateKeeper(0.002)
    keeper.start()
    for _ in range(50):
        keeper.wait()
        assert keeper.lateness_ns >= 0


@pytest.mark.parametrize("reads_before", range(1, 6))
def test_a_pause_at_any_moment_of_the_wait_makes_no_negative_sleep(monkeypatch, reads_before):
    slept, reads = [], []

    def monotonic_ns():
        reads.append(None)
        return 1000 * len(reads) + (50_000_000 if len(reads) > reads_before else 0)

    monkeypatch.setattr("piezod.control.rate_keeper.clock.monotonic_ns", monotonic_ns)
    monkeypatch.setattr("piezod.control.rate_keeper.clock.sleep", slept.append)
    keeper = RealRateKeeper(0.01)
    keeper.start()
    keeper.wait()
    assert len(slept) == 1
    assert slept[0] >= 0.0
