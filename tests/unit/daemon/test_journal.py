"""The log of the daemon: it neither blocks nor ends the program."""

import os
import time
from datetime import datetime

import pytest

from piezod.daemon.journal import MOST_RECENT, MOST_WAITING, Journal


@pytest.fixture
def pipe():
    reader, writer = os.pipe()
    ends = {"reader": reader, "writer": writer}
    yield ends
    for descriptor in ends.values():
        os.close(descriptor)


def test_lines_are_written_in_order(pipe):
    journal = Journal(pipe["writer"])
    for number in range(100):
        journal.add(f"line {number}")
    assert journal.flush()
    assert os.read(pipe["reader"], 1 << 16).decode().splitlines() == [f"line {number}" for number in range(100)]
    assert journal.dropped == 0


def test_the_last_lines_are_kept_with_their_time(pipe):
    journal = Journal(pipe["writer"])
    for number in range(MOST_RECENT + 5):
        journal.add(f"line {number}")
    assert len(journal.recent) == MOST_RECENT
    time_of_day, _, text = journal.recent[-1].partition(" ")
    assert text == f"line {MOST_RECENT + 4}"
    assert abs(datetime.fromisoformat(time_of_day).timestamp() - time.time()) < 60.0


def test_a_reader_that_stands_still_delays_nobody_and_lines_are_dropped_and_counted(pipe):
    journal = Journal(pipe["writer"])
    begun_s = time.monotonic()
    lines = MOST_WAITING + 3000  # a pipe holds 65,536 bytes, which are 655 of these lines
    for _ in range(lines):
        journal.add("x" * 99)
    assert time.monotonic() - begun_s < 5.0  # a write to a full pipe never returns
    assert not journal.flush(0.1)
    assert lines - MOST_WAITING - 700 < journal.dropped <= lines - MOST_WAITING


def test_without_a_reader_lines_are_dropped_and_the_program_goes_on(pipe):
    journal = Journal(pipe["writer"])
    os.close(pipe.pop("reader"))
    journal.add("nobody reads this")
    assert journal.flush()
    assert journal.dropped == 1


def test_a_closed_descriptor_is_no_error(pipe):
    journal = Journal(os.dup(pipe["writer"]))
    os.close(journal._descriptor)
    journal.add("nobody reads this")
    assert journal.flush()
    assert journal.dropped == 1
