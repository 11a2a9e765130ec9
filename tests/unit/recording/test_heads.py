"""What instruments write above the numbers: settings, comments, a row of units."""

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recording import read_recording

N = 120
ROWS = "\n".join(f"{0.005 * k:.3f},{k % 50},{2.0 * (k % 50)}" for k in range(N)) + "\n"
HEADS = {
    "two lines of settings": "Rate: 200 Hz\nOperator: Meyer\ntime_s,cmd_V,force_N\n",
    "settings with commas and an empty line": "Bench, hall 3, left\nOperator, Meyer\n\ntime_s,cmd_V,force_N\n",
    "a comment beside settings": "Rate: 200 Hz\n# warm, after lunch\ntime_s,cmd_V,force_N\n",
    "settings, then names, then units": "Rate: 200 Hz\ntime,cmd,force\ns,V,N\n",
    "a row of units that the names have too": "time_s,cmd_V,force_N\ns,V,N\n",
    "the same behind settings": "Rate: 200 Hz\ntime_s,cmd_V,force_N\ns,V,N\n",
    "units in brackets": "time_s,cmd_V,force_N\n[s],[V],[N]\n",
    "a unit that one name lacks": "time_s,cmd,force_N\ns,V,N\n",
}


@pytest.mark.parametrize("head", HEADS.values(), ids=HEADS)
def test_all_rows_below_a_head_are_read(tmp_path, head):
    path = tmp_path / "rec.csv"
    path.write_text(head + ROWS, encoding="utf-8")
    recording = read_recording(path)
    assert recording.time_s.size == N
    command, force = (name for name in recording.channels if name.split("_")[-1] in ("V", "N"))
    np.testing.assert_allclose(recording.channels[command], np.arange(N) % 50)
    np.testing.assert_allclose(recording.channels[force], 2.0 * (np.arange(N) % 50))


@pytest.mark.parametrize(("units", "column"), [("ms,V,N", "time_s"), ("s,mV,N", "cmd_V"), ("s,V,kN", "force_N")])
def test_a_row_of_units_that_contradicts_a_name_is_refused(tmp_path, units, column):
    path = tmp_path / "rec.csv"
    path.write_text(f"time_s,cmd_V,force_N\n{units}\n{ROWS}", encoding="utf-8")
    with pytest.raises(RecordingError, match=f"column {column} is in .* by the row of units; correct one of them"):
        read_recording(path)
