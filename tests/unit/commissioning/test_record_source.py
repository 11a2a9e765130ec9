"""A recording whose voltage is driven again is read as strictly as a reference file."""

import numpy as np
import pytest

from piezod.commissioning.record import _voltages, excitation_duration_s
from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.errors import PiezodError
from piezod.recording import Recording, write_recording

BENCH = load_bench(shipped("bench.yaml")).model_copy(update={"rate_Hz": 100.0})
ROWS = [f"{k / 100:.2f},{k}" for k in range(30)]


def voltages(folder, rows, end="\n"):
    path = folder / "drive.csv"
    path.write_text("time_s,voltage_V\n" + "\n".join(rows) + end, encoding="utf-8")
    return _voltages(str(path), None, 1.0, 1, BENCH)


def test_30_rows_at_100_hz_are_30_ticks(tmp_path):
    np.testing.assert_array_equal(voltages(tmp_path, ROWS), np.arange(30.0))
    assert excitation_duration_s(str(tmp_path / "drive.csv"), 1.0, 2) == pytest.approx(0.58)


@pytest.mark.parametrize(
    ("rows", "end", "says"),
    [
        ([*ROWS[:5], "0.05,-1.#IND", *ROWS[6:]], "\n", "line 7: voltage_V is '-1.#IND'"),
        (ROWS, "", "line 31, the last one"),
        ([*ROWS, "3600,0"], "\n", "line 32 is 3599.71 s after line 31.*add the missing rows$"),
    ],
)
def test_a_wrong_drive_is_refused_with_its_line(tmp_path, rows, end, says):
    with pytest.raises(PiezodError, match=says):
        voltages(tmp_path, rows, end)


def test_a_missing_voltage_of_a_binary_file_is_refused(tmp_path):
    voltage_V = np.array([0.0, 1.0, np.nan, 3.0])
    write_recording(Recording(np.arange(4) / 100.0, {"voltage_V": voltage_V}), tmp_path / "drive.mat")
    with pytest.raises(PiezodError, match="sample 2: voltage_V is missing"):
        _voltages(str(tmp_path / "drive.mat"), None, 1.0, 1, BENCH)


def test_a_text_of_another_program_is_to_be_converted_first(tmp_path):
    with pytest.raises(PiezodError, match="piezod convert"):
        excitation_duration_s(str(tmp_path / "drive.txt"), 1.0, 1)
