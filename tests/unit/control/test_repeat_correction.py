"""The learned correction in shared memory: exchanged between two repeats, blended in, known again afterwards."""

import sys

import numpy as np
import pytest

from piezod.control.references import TableReference
from piezod.control.references.repeat_correction import RepeatCorrection, correction_cells
from piezod.errors import ConfigurationError

TICKS = 40


@pytest.fixture
def sides():
    """Reader and writer over the same memory."""
    cells = np.zeros(correction_cells(TICKS))
    return RepeatCorrection(cells), RepeatCorrection(cells)


def read(reader, first, count):
    return np.array([reader.read(tick // TICKS, tick % TICKS) for tick in range(first, first + count)])


def test_without_an_offer_nothing_is_corrected(sides):
    reader, _ = sides
    assert (read(reader, 0, 3 * TICKS) == 0.0).all()


def test_an_offer_is_taken_over_at_the_begin_of_the_next_repeat(sides):
    reader, writer = sides
    read(reader, 0, TICKS // 2)
    writer.offer(np.full(TICKS, 3.0))
    assert writer.waiting
    assert (read(reader, TICKS // 2, TICKS // 2) == 0.0).all()
    assert read(reader, TICKS, TICKS)[TICKS // 10 :] == pytest.approx(3.0)
    assert not writer.waiting


def test_an_exchange_is_blended_in(sides):
    reader, writer = sides
    read(reader, 0, TICKS)
    writer.offer(np.full(TICKS, 3.0))
    values = read(reader, TICKS, TICKS)
    assert values[:3] == pytest.approx([1.5, 3.0, 3.0])  # over two ticks, a twentieth of the repeat


def test_a_skipped_first_tick_exchanges_all_the_same(sides):
    reader, writer = sides
    read(reader, 0, TICKS)
    writer.offer(np.full(TICKS, 3.0))
    assert reader.read(1, 5) == 3.0


@pytest.mark.parametrize("seed", range(20))
def test_the_writer_knows_what_every_tick_of_the_last_two_repeats_had(sides, seed):
    reader, writer = sides
    random = np.random.default_rng(seed)
    reader.start(100)
    assert writer.first_tick == 100
    had = []
    for repeat in range(8):
        offered_at = int(random.integers(TICKS)) if random.random() < 0.7 else -1
        for k in range(TICKS):
            if k == offered_at and not writer.waiting:
                writer.offer(random.normal(size=TICKS))
            had.append(reader.read(repeat, k))
        ticks = np.arange(max(0, (repeat - 1) * TICKS), (repeat + 1) * TICKS)
        last = ticks[ticks >= repeat * TICKS - TICKS // 3]
        if not writer.waiting:
            assert writer.used(last // TICKS, last % TICKS) == pytest.approx(np.array(had)[last], abs=1e-12)


def test_an_arming_anew_begins_with_what_was_learned(sides):
    reader, writer = sides
    reader.start(0)
    read(reader, 0, TICKS)
    writer.offer(np.arange(TICKS, dtype=float))
    read(reader, TICKS, TICKS)
    reader.start(1000)
    assert read(reader, 0, TICKS) == pytest.approx(np.arange(TICKS))
    assert writer.used(np.zeros(TICKS, dtype=int), np.arange(TICKS)) == pytest.approx(np.arange(TICKS))


@pytest.mark.parametrize("values", [np.zeros(TICKS + 1), np.full(TICKS, np.nan), np.zeros((TICKS, 1))])
def test_an_offer_of_the_wrong_length_or_without_numbers_is_refused(sides, values):
    with pytest.raises(ValueError, match="must be"):
        sides[1].offer(values)


@pytest.mark.parametrize("cells", [0, 4, 7])
def test_memory_without_room_for_a_repeat_is_refused(cells):
    with pytest.raises(ValueError, match="even number"):
        RepeatCorrection(np.zeros(cells))


def test_a_looped_table_plans_the_corrected_force_and_reports_its_own(sides):
    reader, writer = sides
    table = TableReference(np.arange(TICKS, dtype=float), loop=True)
    table.correct_by(reader)
    table.start(7)
    writer.offer(np.full(TICKS, 0.5))
    for tick in range(7, 7 + 2 * TICKS):
        value = table.read(tick, 0)
        assert value == (tick - 7) % TICKS
        assert table.ahead == pytest.approx(value + 0.5, abs=0.26 if tick < 9 else 1e-12)


@pytest.mark.parametrize("table", [TableReference(np.zeros(TICKS)), TableReference(np.zeros(TICKS + 1), loop=True)])
def test_a_table_that_ends_or_is_longer_takes_no_correction(sides, table):
    with pytest.raises(ConfigurationError, match="must be equal, and the table looped"):
        table.correct_by(sides[0])


def test_a_tick_with_a_correction_allocates_nothing(sides):
    reader, writer = sides
    table = TableReference(np.arange(TICKS, dtype=float), loop=True)
    table.correct_by(reader)
    table.start(0)
    writer.offer(np.full(TICKS, 0.5))
    for tick in range(10 * TICKS):
        table.read(tick, 0)
    before = sys.getallocatedblocks()
    for tick in range(10 * TICKS, 2000 * TICKS):
        table.read(tick, 0)
    assert sys.getallocatedblocks() - before < 20
