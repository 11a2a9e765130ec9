"""How a command runs between samples: metadata of a recording, number of the compiled functions, time to the next."""

import pytest

from piezod.recording.hold import HELD_BEFORE, HELD_ONE_SAMPLE, STRAIGHT, Hold


@pytest.mark.parametrize(
    ("hold", "number", "until_next"),
    [(STRAIGHT, 0.0, 0.5), (Hold("held", 0.3), 0.3, 0.7), (HELD_ONE_SAMPLE, 1.0, 0.0), (HELD_BEFORE, 2.0, 1.0)],
)
def test_a_hold_has_a_number_for_compiled_functions_and_a_time_to_the_next_command(hold, number, until_next):
    assert hold.number == number
    assert hold.until_next == pytest.approx(until_next)


def test_a_command_that_is_read_at_once_counts_as_held_and_not_as_straight():
    assert 0.0 < Hold("held", 0.0).number < 1e-5


@pytest.mark.parametrize("read_after", [0.25, 1.0])
def test_a_held_command_survives_the_metadata_of_a_recording(read_after):
    hold = Hold("held", read_after)
    assert Hold.from_metadata({"bench": "one"} | hold.metadata) == hold


def test_the_ring_log_writes_held_and_read_after_1():
    assert HELD_ONE_SAMPLE.metadata == {"sampling": "held", "read_after": "1"}


@pytest.mark.parametrize(
    "metadata",
    [
        {},
        {"sampling": "straight"},
        {"sampling": "held"},
        {"sampling": "held", "read_after": "soon"},
        {"sampling": "held", "read_after": "0"},
        {"sampling": "held", "read_after": "1.5"},
        {"sampling": "held", "read_after": "nan"},
    ],
)
def test_metadata_without_a_time_of_reading_states_no_hold(metadata):
    assert Hold.from_metadata(metadata) is None
