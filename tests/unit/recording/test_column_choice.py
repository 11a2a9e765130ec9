"""Which columns a model is identified on where the user names none."""

from pathlib import Path

import pytest

from piezod.errors import RecordingError
from piezod.recording.conversion import choose_columns


def chosen(*names, **given):
    return choose_columns(Path("rec.csv"), ("time_s", *names), {"input": None, "output": None} | given)


@pytest.mark.parametrize(
    ("names", "expected", "notes"),
    [
        (("voltage_V", "force_N"), ("voltage_V", "force_N"), 0),
        (("voltage_V", "force_N", "displacement_um", "temperature_C"), ("voltage_V", "force_N"), 0),
        (("force_lbf", "voltage_mV"), ("voltage_V", "force_N"), 0),
        (("voltage_V", "displacement_um"), ("voltage_V", "displacement_um"), 1),
        (("voltage_V", "Position_um", "current_A", "temperature_C"), ("voltage_V", "Position_um"), 1),
        (("u", "y"), ("u", "y"), 2),
        (("output", "input"), ("input", "output"), 2),
        (("V_mon", "force_N"), ("V_mon", "force_N"), 1),
        (("CH1", "force_N"), ("CH1", "force_N"), 1),
    ],
)
def test_the_names_tell_input_and_output(names, expected, notes):
    *found, said = chosen(*names)
    assert tuple(found) == expected
    assert len(said) == notes


@pytest.mark.parametrize(
    "names", [("CH1", "CH2"), ("voltage_V", "a", "b"), ("u", "v", "y"), ("voltage_V", "temperature_C")]
)
def test_columns_that_the_names_do_not_tell_are_refused_with_the_options(names):
    with pytest.raises(RecordingError, match="--input or --output"):
        chosen(*names)


def test_a_named_column_is_taken_and_the_other_one_follows():
    assert chosen("CH1", "CH2", input="CH2")[:2] == ("CH2", "CH1")
    assert chosen("voltage_V", "force_N", "displacement_um", output="displacement_um")[:2] == (
        "voltage_V",
        "displacement_um",
    )
