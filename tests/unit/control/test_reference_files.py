"""Reference files: what must be refused, with its line, and what must be exact to the sample.

`python -m tests.unit.control.test_reference_files` prints the files and their results.
"""

import os
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.config.reference import FileReference
from piezod.config.reference_range import ReferenceRange
from piezod.control.references import file_table
from piezod.errors import ConfigurationError

ANY = ReferenceRange(-1e6, 1e6)
HEAD = "time_s,reference_N\n"
ROWS = [f"{k / 100:.2f},{100 + k}" for k in range(30)]


def table_of(folder, text, rate_Hz=100.0, **keys):
    path = folder / "reference.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file_table(FileReference(kind="file", path=path.name, **keys), rate_Hz, folder, ANY)


def lines(rows):
    return HEAD + "".join(f"{row}\n" for row in rows)


def with_cell(cell):
    return lines([*ROWS[:5], f"0.05,{cell}", *ROWS[6:]])


def sampled(function, rate_Hz, duration_s=4.0):
    times = np.arange(round(duration_s * rate_Hz) + 1) / rate_Hz
    return lines(f"{time:.6f},{value:.9g}" for time, value in zip(times, function(times), strict=True))


NOT_NUMBERS = (
    *("-1.#IND", "1.#INF", "1.#QNAN", "nan", "nan(ind)", "#N/A", "NA", "null", "None", "-", "---", "", "inf", "-inf"),
    *("1_000", "0x10", "1,5", "1.5 # was 2", '"1.5"', "\u22121.5", "1e999", "\u0661", "1.5\x00", "1d2", "1.5N", "=1.5"),
)


@pytest.mark.parametrize("cell", NOT_NUMBERS)
def test_a_cell_that_is_no_plain_number_is_refused_with_line_and_column(tmp_path, cell):
    with pytest.raises(ConfigurationError, match=r"line 7(: reference_N is .*must be (a number|finite)| has 3 cells)"):
        table_of(tmp_path, with_cell(cell))


REFUSED = {
    "a Windows NaN": (with_cell("-1.#IND"), {}, "line 7: reference_N is '-1.#IND', must be a number"),
    "a comment inside a row": (with_cell("105 # was 5"), {}, "line 7: reference_N is '105 # was 5'"),
    "a last line cut short": (lines(ROWS)[:-3], {}, "line 31, the last one, is '0.29,1' without a line end"),
    "a gap of an hour": (lines([*ROWS, "3600.29,100"]), {}, "line 32 is 3600 s after line 31, must be at most 0.015 s"),
    "a missing row": (lines([*ROWS[:9], *ROWS[10:]]), {}, "line 11 is 0.02 s after line 10, must be at most 0.015 s"),
    "a gap of unevenly spaced rows": (
        lines(["0,0", "0.01,1", "0.03,2", "0.04,3", "0.06,4", "0.50,5"]),
        {},
        "line 7 is 0.44 s after line 6, must be at most 0.2 s, 10 times the median step",
    ),
    "a time that falls": (lines([*ROWS, "0.20,1"]), {}, "line 32: time_s is 0.2 after 0.29, must not fall"),
    "three rows at one time": (lines(["0,1", "1,1", "1,2", "1,3"]), {}, "line 5 is the third row at 1 s"),
    "a row of another length": (lines([*ROWS, "0.30,1,2"]), {}, "line 32 has 3 cells, the header names 2 columns"),
    "a blank line between rows": (lines([*ROWS[:9], "", *ROWS[9:]]), {}, "line 11 is blank between two rows"),
    "a loop that repeats its first row": (
        lines([*ROWS[:10], "0.10,100"]),
        {"loop": True},
        "line 12, the last one, repeats the first row.*drop .period 10 ticks. or keep .period 11 ticks.",
    ),
    "a tone above half the tick rate": (
        sampled(lambda t: 100 + 10 * np.sin(2 * np.pi * 70.0 * t), 1000.0),
        {},
        "from line 2 on it holds .* N above 50 Hz, half the tick rate",
    ),
    "a loop that ends between two ticks": (lines(["0,1", "0.005,2"]), {"loop": True}, "is 0.5 ticks after the first"),
    "a force in kilonewtons": (
        lines(ROWS).replace("reference_N", "force_kN"),
        {"column": "force_kN"},
        "reference.scale is 1; set scale to 1000 N per kN",
    ),
    "bytes that are no text": (lines(ROWS[:3]).encode() + b"0.03,\xff\n", {}, "line 5 is not UTF-8 text"),
    "zeros after a power cut": (lines(ROWS) + "\x00" * 40 + "\n", {}, "line 32: time_s is"),
    "a header alone": (HEAD, {}, "has a header but no rows"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_reference_file_is_refused_with_its_line(tmp_path, name):
    text, keys, says = REFUSED[name]
    with pytest.raises(ConfigurationError, match=says):
        table_of(tmp_path, text, **keys)


def one_third(k):
    return f"{k / 300:.6f},{k}"


EXACT = {
    "0.29 s at 100 Hz": (lines(ROWS), 100.0, {}, range(100, 130)),
    "times since 1970": (lines(f"{1764219000 + k / 100:.2f},{k}" for k in range(30)), 100.0, {}, range(30)),
    "times rounded to a microsecond at 300 Hz": (lines(map(one_third, range(301))), 300.0, {}, range(301)),
    "times with the error of a sum": (
        lines(f"{float(t)!r},{k}" for k, t in enumerate(np.cumsum([0.1] * 41))),
        10.0,
        {},
        range(41),
    ),
    "every second row on a tick": (lines(f"{k / 200},{k / 2}" for k in range(61)), 100.0, {}, range(31)),
    "rows slower than the ticks": (lines(["0,0", "0.1,10", "0.2,0"]), 100.0, {}, [*range(11), *range(9, -1, -1)]),
    "a jump at one time": (lines(["0,1", "0.02,1", "0.02,5", "0.04,5"]), 100.0, {}, [1, 1, 5, 5, 5]),
    "an end between two ticks": (lines(["0,0", "0.01,1", "0.025,2.5"]), 100.0, {}, [0, 1, 2]),
    "a closed loop, the last row dropped": (
        lines(["0,0", "0.02,2", "0.04,0"]),
        100.0,
        {"loop": True, "closing_row": "drop"},
        [0, 1, 2, 1],
    ),
    "a closed loop, the last row kept": (
        lines(["0,0", "0.02,2", "0.04,0"]),
        100.0,
        {"loop": True, "closing_row": "keep"},
        [0, 1, 2, 1, 0],
    ),
    "metadata, comment lines, CRLF and a byte order mark": (
        "\ufeff# bench: press\r\ntime_s , reference_N\r\n0, +1.\r\n# later\r\n1e-2,.5e1\r\n\r\n",
        100.0,
        {},
        [1, 5],
    ),
    "a stated gap": (lines(["0,0", "0.01,0", "0.02,0", "0.22,20"]), 100.0, {"longest_step_s": 0.2}, [0, 0, *range(21)]),
}


@pytest.mark.parametrize("name", EXACT)
def test_a_right_reference_file_is_exact_to_the_sample(tmp_path, name):
    text, rate_Hz, keys, expected = EXACT[name]
    values = table_of(tmp_path, text, rate_Hz, **keys).values()
    assert values.size == len(expected)
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12)


@given(rows=st.integers(1, 3000), rate_Hz=st.sampled_from([1, 3, 7, 10, 50, 60, 100, 128, 200, 300, 500, 999, 1000]))
def test_a_file_at_the_tick_rate_has_one_tick_a_row(tmp_path_factory, rows, rate_Hz):
    folder = tmp_path_factory.mktemp("rows")
    text = lines(f"{k / rate_Hz:.9f},{k % 17}" for k in range(rows))
    np.testing.assert_array_equal(table_of(folder, text, float(rate_Hz)).values(), np.arange(rows) % 17)


@given(
    rows=st.integers(2, 400),
    step_ms=st.integers(1, 5000),
    rate_Hz=st.integers(1, 1000),
)
def test_length_and_values_are_those_of_rational_arithmetic(tmp_path_factory, rows, step_ms, rate_Hz):
    """A ramp of 1 N a second: tick k is k / rate_Hz; the last tick is not after the last row."""
    folder = tmp_path_factory.mktemp("ramp")
    text = lines(f"{k * step_ms / 1000:.3f},{k * step_ms / 1000:.3f}" for k in range(rows))
    values = table_of(folder, text, float(rate_Hz)).values()
    assert values.size == Fraction((rows - 1) * step_ms, 1000) * rate_Hz // 1 + 1
    np.testing.assert_allclose(values, np.arange(values.size) / rate_Hz, rtol=0, atol=1e-9)


@pytest.mark.parametrize("rate_Hz", [100.0, 150.0, 250.0])
@pytest.mark.parametrize("shape", ["triangle", "square", "sine below half the tick rate", "steps of a quantiser"])
def test_corners_jumps_and_slow_tones_of_a_faster_file_do_not_fold(tmp_path, shape, rate_Hz):
    shapes = {
        "triangle": lambda t: 100 * np.abs(t % 1.0 - 0.5),
        "square": lambda t: 100.0 * (np.rint(t * 1000) % 500 < 250),
        "sine below half the tick rate": lambda t: 100 * np.sin(2 * np.pi * 0.35 * rate_Hz * t),
        "steps of a quantiser": lambda t: np.round(100 * np.sin(2 * np.pi * t), 1),
    }
    assert len(table_of(tmp_path, sampled(shapes[shape], 1000.0), rate_Hz)) == 4 * rate_Hz + 1


@pytest.mark.parametrize("share", [0.55, 0.7, 0.98, 1.0, 1.02, 2.4])
def test_a_small_tone_above_half_the_tick_rate_is_refused(tmp_path, share):
    text = sampled(lambda t: 100 * np.sin(2 * np.pi * t) + np.cos(2 * np.pi * 100.0 * share * t + 0.4), 1000.0)
    with pytest.raises(ConfigurationError, match="half the tick rate"):
        table_of(tmp_path, text)


def test_a_short_burst_above_half_the_tick_rate_is_refused_with_its_place(tmp_path):
    text = sampled(lambda t: 100.0 + np.where((t > 2) & (t < 3), np.sin(2 * np.pi * 81.0 * t), 0.0), 1000.0)
    with pytest.raises(ConfigurationError, match=r" (1\.9|2\.)\d+ s after its start"):
        table_of(tmp_path, text)


@pytest.mark.parametrize("last", ["0", "1e-6", "-0.0000015"])
def test_a_loop_whose_last_row_repeats_the_first_but_for_rounding_is_asked_about(tmp_path, last):
    with pytest.raises(ConfigurationError, match="closing_row to drop"):
        table_of(tmp_path, lines(["0,0", "0.02,2", f"0.04,{last}"]), 100.0, loop=True)


def test_closing_row_without_a_loop_is_refused():
    with pytest.raises(ValueError, match="closing_row is drop, must be null where loop is false"):
        FileReference(kind="file", path="x.csv", closing_row="drop")


@pytest.mark.parametrize("make", ["folder", "fifo", "device", "nothing"])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, make):
    path = tmp_path / "reference.csv"
    if make == "folder":
        path.mkdir()
    elif make == "fifo":
        os.mkfifo(path)
    elif make == "device":
        path.symlink_to("/dev/zero")
    with pytest.raises(ConfigurationError, match=r"must be a regular file|No such file|Is a directory"):
        file_table(FileReference(kind="file", path=path.name), 100.0, tmp_path, ANY)


def print_table(folder):
    """Print a line for each file: what is refused with its words, what is exact with its number of ticks."""
    for name, (text, keys, _) in REFUSED.items():
        try:
            result = f"NOT REFUSED: {len(table_of(folder, text, **keys))} ticks"
        except ConfigurationError as error:
            result = str(error).removeprefix("reference.path: ").replace(f"{folder}/", "")
        print(f"refused  {name:40} {result}")
    for name, (text, rate_Hz, keys, expected) in EXACT.items():
        values = table_of(folder, text, rate_Hz, **keys).values()
        is_exact = values.size == len(expected) and np.abs(values - np.array(expected)).max() <= 1e-12
        print(f"{'exact' if is_exact else 'WRONG':8} {name:52} {values.size} ticks at {rate_Hz:g} Hz")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        print_table(Path(place))
