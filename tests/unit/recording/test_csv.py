"""CSV recordings: there and back, and what is refused."""

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recording import Recording, read_csv, write_csv


def test_what_is_written_is_read_back(tmp_path):
    rng = np.random.default_rng(1)
    time_s = np.cumsum(rng.uniform(1e-4, 1e-2, 200))
    recording = Recording(
        time_s, {"voltage_V": rng.normal(size=200), "force_N": rng.normal(size=200)}, {"bench": "a b"}
    )
    write_csv(recording, tmp_path / "rec.csv")
    again = read_csv(tmp_path / "rec.csv")
    np.testing.assert_allclose(again.time_s, time_s, atol=5e-10)
    np.testing.assert_allclose(again.channel("force_N"), recording.channel("force_N"), rtol=1e-8)
    assert again.metadata == {"bench": "a b"}
    assert list(again.channels) == ["voltage_V", "force_N"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty, must hold a header row"),
        ("time_s,force_N\n", "has a header but no samples"),
        ("t,force_N\n0,1\n", "first column is 't', must be time_s"),
        ("time_s,force_N,force_N\n0,1,2\n", "column names must be unique"),
        ("time_s,force_N\n0,1\n0,2\n", "time_s must strictly increase, sample 1"),
        ("time_s,force_N\n0,1\n1,x\n", "line 3: force_N is 'x', must be a number or empty"),
        ("time_s,force_N\n0,1\nnan,2\n", "not finite"),
        ("time_s,force_N\n0,1,5\n1,2,5\n", "line 2 has 3 cells, the header names 2 columns"),
    ],
)
def test_a_file_that_is_no_recording_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "rec.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError, match=message) as caught:
        read_csv(path)
    assert str(caught.value).startswith(str(path))


def test_metadata_cannot_break_out_of_its_line(tmp_path):
    recording = Recording(np.array([0.0, 1.0]), {"force_N": np.zeros(2)}, {"note": "a\ntime_s,evil\n"})
    write_csv(recording, tmp_path / "rec.csv")
    assert read_csv(tmp_path / "rec.csv").metadata == {"note": "a time_s,evil"}
