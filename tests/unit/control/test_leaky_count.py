"""Leaky counts: which rates of wrong samples trip, and what the ring log and the status show of them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.control import State
from piezod.control.leaky_count import CELLS, FIRST_COUNTER, WRONG, CountedInterlock, LeakyCount, interlock_counts
from piezod.daemon.status import _counts_text
from piezod.recording.ring_log import COUNTERS, RingReader
from piezod.transport import ExchangeResult
from tests.unit.control.fake_bench import FakeLink
from tests.unit.control.loops import armed_loop, run


def shown(tmp_path, interlock):
    counts = interlock_counts(RingReader(tmp_path / "ring").counters)[interlock]
    return counts["wrong"], counts["level"], counts["highest"]


@given(st.lists(st.booleans(), max_size=200), st.integers(1, 40))
def test_level_highest_and_wrong_samples_are_those_of_the_definition(samples, needed):
    count, level, highest = LeakyCount(WRONG * needed), 0, 0
    cells = memoryview(bytearray(8 * CELLS)).cast("Q")
    count.show_in(cells)
    for wrong in samples:
        if wrong:
            level += WRONG
            assert count.add() == (level >= WRONG * needed)
        elif level:
            level -= 1
            count.leak()
        highest = max(highest, level)
    assert cells.tolist() == [sum(samples), level, highest, WRONG * needed]


def test_a_count_in_other_cells_keeps_its_numbers_and_clear_keeps_the_wrong_samples():
    count = LeakyCount(12)
    count.add()
    cells = memoryview(bytearray(8 * CELLS)).cast("Q")
    count.show_in(cells)
    assert cells.tolist() == [1, 3, 3, 12]
    count.clear()
    assert cells.tolist() == [1, 0, 0, 12]


def test_the_ring_log_has_room_for_every_interlock_and_an_earlier_one_shows_none():
    assert FIRST_COUNTER + CELLS * len(CountedInterlock) <= COUNTERS
    assert interlock_counts([0] * 8) == interlock_counts(()) == {}


def test_two_forces_above_the_trip_show_in_the_ring_log_and_leak_away(ring_log, tmp_path):
    link = FakeLink()
    loop = armed_loop(link, ring_log, force_debounce_samples=4)
    run(loop, 300)
    assert shown(tmp_path, "force") == (0, 0.0, 0.0)
    link.plant = lambda voltage_V: 900.0
    run(loop, 2)
    assert shown(tmp_path, "force") == (2, 6 / 12, 6 / 12)
    link.plant = lambda voltage_V: 2.0 * voltage_V
    run(loop, 4)
    assert shown(tmp_path, "force") == (2, 2 / 12, 6 / 12)
    run(loop, 4)
    assert shown(tmp_path, "force") == (2, 0.0, 6 / 12)
    assert loop.supervisor.state is State.RUNNING


def test_every_second_force_above_the_trip_is_shown_and_trips(ring_log, tmp_path):
    link = FakeLink()
    loop = armed_loop(link, ring_log, force_debounce_samples=4)
    run(loop, 300)
    for _ in range(8):
        link.plant = lambda voltage_V: 900.0
        run(loop, 1)
        link.plant = lambda voltage_V: 2.0 * voltage_V
        run(loop, 1)
    wrong, _, highest = shown(tmp_path, "force")
    assert loop.supervisor.state is State.RAMP_DOWN
    assert wrong == 8
    assert highest >= 1.0


@pytest.mark.parametrize("driven", [True, False])
def test_failed_exchanges_count_while_voltages_are_written(ring_log, tmp_path, driven):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    if not driven:
        loop.supervisor.stop()
        run(loop, 1000)
        assert loop.supervisor.state is State.DISARMED
    link.fails, link.poll = lambda _: True, lambda: ExchangeResult.TIMEOUT
    run(loop, 3)
    assert shown(tmp_path, "exchanges")[0] == (3 if driven else 0)


def test_the_status_names_the_interlocks_that_saw_a_wrong_sample():
    counts = {
        "force": {"wrong": 951, "level": 0.25, "highest": 0.5},
        "missed_ticks": {"wrong": 2, "level": 0.0, "highest": 0.06},
        "tracking": {"wrong": 0, "level": 0.0, "highest": 0.0},
    }
    text = _counts_text(counts)
    assert text.endswith(": force 951 (25 %, 50 %), missed ticks 2 (0 %, 6 %)")
    assert _counts_text({}) == ""
