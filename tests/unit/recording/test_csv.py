"""CSV recordings: writing, reading, and files that are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezod.errors import RecordingError
from piezod.recording import Recording, read_csv, write_csv
from piezod.recording.formats import plain_rows, text


def test_a_csv_recording_is_read_back_as_it_was_written(tmp_path):
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


def test_line_ends_in_metadata_are_replaced_by_spaces(tmp_path):
    recording = Recording(np.array([0.0, 1.0]), {"force_N": np.zeros(2)}, {"note": "a\ntime_s,evil\n"})
    write_csv(recording, tmp_path / "rec.csv")
    assert read_csv(tmp_path / "rec.csv").metadata == {"note": "a time_s,evil"}


def test_empty_cells_are_missing_samples(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("time_s,a_V,b_N\n0,,1\n1, ,\n2,nan,3\r\n", encoding="utf-8", newline="")
    recording = read_csv(path)
    assert recording.missing("a_V").all()
    assert recording.missing("b_N").tolist() == [False, True, False]


def test_an_empty_time_cell_is_refused(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("time_s,a_V\n0,1\n,2\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="time_s of sample 1 is not finite"):
        read_csv(path)


def test_a_wrong_cell_far_in_a_long_file_is_named_by_its_line(tmp_path, monkeypatch):
    monkeypatch.setattr(text, "BLOCK", 64)
    path = tmp_path / "rec.csv"
    rows = [f"{k},{k}" for k in range(500)]
    rows[400] = "400,4OO"
    path.write_text("# a: b\ntime_s,a_V\n" + "\n".join(rows), encoding="utf-8")
    with pytest.raises(RecordingError, match="line 403: a_V is '4OO'"):
        read_csv(path)


@given(n=st.integers(1, 200), size=st.integers(20, 300))
def test_the_size_of_blocks_does_not_change_the_numbers(tmp_path_factory, n, size):
    path = tmp_path_factory.mktemp("csv") / "rec.csv"
    rng = np.random.default_rng(n)
    recording = Recording(np.arange(float(n)), {"a_V": rng.normal(size=n)})
    write_csv(recording, path)
    whole = read_csv(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text, "BLOCK", size + 40)
        np.testing.assert_array_equal(read_csv(path).channel("a_V"), whole.channel("a_V"))


CELL = st.one_of(
    st.floats().map(repr),
    st.from_regex(r"[+-]?[0-9]{0,25}\.?[0-9]{0,25}([eE][+-]?[0-9]{1,3})?", fullmatch=True),
    st.sampled_from(["", "nan", "NaN", "-inf", "Infinity", "0x10", "1e", "+1", "1_0", "NULL", "N/A", "true", "-0.0"]),
)


@settings(max_examples=300)
@given(rows=st.lists(st.tuples(CELL, CELL), min_size=1, max_size=4))
def test_pyarrow_gives_the_numbers_of_numpy_or_refuses_the_block(rows):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    block = "".join(",".join(row) + "\n" for row in rows).encode()
    try:
        quick = plain_rows.arrow_parser(2, (0, 1))(block)
    except ValueError:
        return
    exact = plain_rows.row_parser(2, (0, 1), large=False)(text.with_empty_cells(block))
    assert quick.tobytes() == exact.tobytes() or np.array_equal(quick, exact, equal_nan=True)
    np.testing.assert_array_equal(np.signbit(quick[quick == 0]), np.signbit(exact[exact == 0]))


@pytest.mark.parametrize("name", ["a,b", "a\nb", "#a", " a", ""])
def test_a_name_that_would_break_the_header_is_not_written(tmp_path, name):
    with pytest.raises(RecordingError, match="is no column name"):
        write_csv(Recording(np.zeros(1), {name: np.zeros(1)}), tmp_path / "rec.csv")


def test_samples_closer_than_the_resolution_of_csv_are_not_written(tmp_path):
    with pytest.raises(RecordingError, match="closer than 1 ns"):
        write_csv(Recording(np.array([0.0, 1e-10]), {}), tmp_path / "rec.csv")
